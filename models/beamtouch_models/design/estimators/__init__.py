"""Estimators as ONNX graphs, and their training.

`estimator` makes them by their names in `beamtouch_models.names`. All but the paper's network end in the posterior of
`posterior/`; `small_network` only finds where to look first.
"""
