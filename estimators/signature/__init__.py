"""The signature: what a technician reads off the loop of force against travel, with intervals."""
