"""The border of a plot: where it lies, which stems stand in it, how much of it was seen, and figures a hectare."""
