"""Measured trees against extracted ones."""
