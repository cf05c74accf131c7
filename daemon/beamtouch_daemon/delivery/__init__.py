"""Samples to the service: outbox, spool, client."""
