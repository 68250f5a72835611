"""The audit log: who did what, chained entry to entry, on disk before a valve moves."""
