"""One owner a bus, in this process and between processes."""
