"""A loop without a stem position: whether it oscillates, and whether its valve is the likely cause."""
