"""The store as one file, and a store of such a file."""
