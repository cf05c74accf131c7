"""Zones: whether the contact is in a part of the beam, sample by sample. Pure: no web, no files, no wall clock."""
