"""The posterior of a contact over a grid of places, as an ONNX graph.

`answers` has its formulas and what the graph states. `cells` makes a graph on cells that are the same for every sample,
`window` one on cells around a place, `plane` one of two axes; `posterior_graph` of `window` chooses between them.
"""
