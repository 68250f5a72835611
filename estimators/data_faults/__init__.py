"""Faults of the data: found before anything is estimated, left out or put right, and said."""
