"""Photographs and videos to the frames worth using."""
