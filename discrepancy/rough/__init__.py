"""What the simulation gets wrong on a real valve: latent friction, causes that explain a part of it, and the gain."""
