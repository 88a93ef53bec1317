"""Simulated clouds of stems, without a renderer."""
