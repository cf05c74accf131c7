"""Samples to the service: the log, its two readers, the client."""
