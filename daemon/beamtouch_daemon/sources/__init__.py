"""Devices and buses: bytes to readings."""
