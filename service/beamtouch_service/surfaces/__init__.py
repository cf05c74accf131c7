"""Samples to a contact: no web, no files, no wall clock."""
