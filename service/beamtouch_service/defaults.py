"""What holds where nothing else is said: in the configuration, and without one. Needs no extra."""

STALE_MS = 500.0
BATCHES_PER_S = 2000.0
"""For each surface."""
MAX_STREAMS = 32
MAX_CLIENTS = 256
MAX_CLIENTS_PER_ADDRESS = 128
"""Without a token: half, so that one address cannot take all of the room."""
KEEP_DAYS = 30.0
MOST_MB = 100.0
"""Of events."""
