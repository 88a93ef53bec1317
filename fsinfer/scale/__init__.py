"""The metric scale: markers, end points, a factor, and doubts about it."""
