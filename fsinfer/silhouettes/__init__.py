"""Edges of stems in the photographs, joined with the cloud's diameters."""
