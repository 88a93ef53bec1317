"""A synthetic forest with exact truth, rendered by ray casting: ``python -m training.synthesize OUT --seed S``."""
