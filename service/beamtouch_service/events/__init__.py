"""The record of contacts: segments from decided samples, joined to events and stored."""
