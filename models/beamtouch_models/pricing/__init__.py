"""Noise, filter, and the price of each physical effect in a scene."""
