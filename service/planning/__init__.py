"""What a test would tell of a valve, before it is run."""
