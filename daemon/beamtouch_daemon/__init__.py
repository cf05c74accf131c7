"""The acquisition daemon: device to reading to sample to service."""
