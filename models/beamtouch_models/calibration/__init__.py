"""Calibration of a model with recorded loads."""
