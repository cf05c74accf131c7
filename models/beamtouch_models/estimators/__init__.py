"""Estimators: turn a prior into an ONNX graph that gives position, force, their intervals and the odds of contact."""
