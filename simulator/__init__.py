"""The software valve on a wire: what a service meets when the configured address leads to a simulation."""
