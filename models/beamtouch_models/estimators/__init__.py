"""Estimators as ONNX graphs, and their training."""
