"""Nightly checks: when each valve is due, its turn on its bus, and what became of it."""
