"""What lies in an output folder, and what ``plot.json`` says."""
