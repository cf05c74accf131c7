"""The posterior of a contact over a grid of positions, as an ONNX graph; see `answers`."""
