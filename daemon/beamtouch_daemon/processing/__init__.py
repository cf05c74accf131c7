"""Readings to samples: characteristic, quality, zero, filters. Pure.

`pipeline` has the steps in their order. `filters` only configures those of `beamtouch_models.filters`.
"""
