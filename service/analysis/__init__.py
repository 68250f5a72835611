"""A recording's analysis: signature, estimates, diagnosis, and notes of what to distrust."""
