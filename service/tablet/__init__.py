"""The tablet: pages made here, one small script, one style sheet, and nothing from any other host."""
