"""Pictures of an analysis as SVG: the loop, trends, the misfit and the methods beside each other."""
