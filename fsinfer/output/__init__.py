"""What lies in an output folder, what ``plot.json`` says, and what is packed from it for support."""
