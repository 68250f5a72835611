"""plant.toml: read, checked fault by fault, and what fills it."""
