"""Placement of the sensors."""
