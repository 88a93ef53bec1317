"""Export of trained FS-MVSNet to ONNX, and the proof that ONNX and PyTorch agree."""
