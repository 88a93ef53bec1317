"""Diameter at breast height from a slice, an outline and silhouettes, with its interval."""
