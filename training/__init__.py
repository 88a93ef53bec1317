"""Training of FS-MVSNet: model, synthetic forest, data sets, training and evaluation (needs PyTorch)."""
