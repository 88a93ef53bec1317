"""Depth maps to one point cloud."""
