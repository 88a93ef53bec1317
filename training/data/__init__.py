"""Scenes with true depth, whatever their layout on disk, and the samples that training draws from them."""
