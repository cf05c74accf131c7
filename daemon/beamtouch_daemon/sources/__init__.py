"""Devices and buses: bytes to readings.

A new kind of source has its settings in `config/sources.py`, a module here, and its case in `configured`.
`Surface.place_of` in `config/settings.py` says where its channels are.
"""
