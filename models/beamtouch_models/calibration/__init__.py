"""Calibration: from a few known loads to a model of the real beam."""
