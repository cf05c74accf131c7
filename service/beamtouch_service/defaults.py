"""What holds where nothing else is said: in the configuration, and without one. Needs no extra."""

STALE_MS = 500.0
BATCHES_PER_S = 2000.0
"""For each surface."""
MAX_STREAMS = 32
MAX_CLIENTS = 256
MOST_CLIENTS = 4096
"""All of them are looked through for the one that makes room for a newcomer."""
KEEP_DAYS = 30.0
MOST_MB = 100.0
"""Of events."""
