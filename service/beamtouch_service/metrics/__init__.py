"""Metrics for Prometheus: counts that the parts of the service keep, and figures read from their state when asked."""
