"""The process: its socket, its certificate, its log, and what it tells the service manager."""
