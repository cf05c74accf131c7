"""Readings to samples: characteristic, quality, zero, filters. Pure."""
