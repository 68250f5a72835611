"""Recordings as their owners have them: found in the file, understood, converted, and said."""
