"""A valve in service from a file: read with or without a nameplate, and what was found in words."""
