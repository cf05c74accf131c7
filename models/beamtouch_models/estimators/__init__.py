"""Estimators: from a prior to an ONNX graph that answers where, how hard and how surely. Trained offline, all alike."""
