"""Measurements of speed and accuracy, outside the test run: ``make bench``."""
