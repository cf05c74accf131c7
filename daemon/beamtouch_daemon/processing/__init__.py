"""Readings to samples: characteristic, quality, filters, zero. Pure.

`pipeline` has the steps in their order. `filters` only configures those of `beamtouch_models.filters`.
"""
