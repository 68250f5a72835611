"""Recordings over the REST interface: formats, and analysis of those that come from elsewhere."""
