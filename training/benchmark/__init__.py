"""The DTU benchmark's own evaluation."""
