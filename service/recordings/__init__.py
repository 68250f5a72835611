"""Recordings as files: where each is, and other formats made of them."""
