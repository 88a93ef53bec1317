"""Depth and confidence of every view: the network, its cost volume, and the stage that runs them over a scene."""
