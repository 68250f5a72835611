"""The report of a test: one document of words and pictures, written as HTML and as PDF."""
