"""Noise, filter, and the price of each physical effect in a scene.

`prices` has the effects, each a function. `noise` chooses the filter that fits the latency.
"""
