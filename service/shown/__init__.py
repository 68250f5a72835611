"""What a result says, in words, rows and layers: the pages and the report show it alike."""
