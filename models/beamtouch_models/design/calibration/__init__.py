"""Calibration of a model with recorded loads, or with contacts of unknown place and force."""
