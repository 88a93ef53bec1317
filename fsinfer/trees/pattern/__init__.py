"""Stem maps of parts of one plot, put together by the pattern of their stems."""
