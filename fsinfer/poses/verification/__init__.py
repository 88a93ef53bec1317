"""Whether photographs are registered where they were taken, and what is done where they are not."""
