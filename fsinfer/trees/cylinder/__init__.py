"""Axis of a stem from its points."""
