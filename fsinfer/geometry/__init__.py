"""What several stages need of geometry; NumPy and SciPy only."""
