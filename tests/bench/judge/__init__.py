"""A judge of the diagnosis: valves by fixed steps, what is hidden in them, and how the answers are graded."""
