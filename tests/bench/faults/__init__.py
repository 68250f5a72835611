"""Faults put on the wire and into the service, judged by the simulated valve's own record."""
