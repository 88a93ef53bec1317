"""Stems found in a cloud, and verified."""
