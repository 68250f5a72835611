"""Health: each result against the valve's baseline, its history and its limits; NAMUR NE 107 states with reasons."""
