"""What a run leaves in its output folder, and what is packed from it."""
