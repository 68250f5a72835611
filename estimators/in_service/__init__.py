"""A valve in service: what its loop's own moves say of friction, dead band, spring and travel."""
