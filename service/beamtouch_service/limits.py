"""Default limits, for the configuration and for those who use the parts of the service without one."""

STALE_MS = 500.0
"""No contact is given from a sample older than this."""
UNEXPLAINED_AFTER_S = 10.0
"""An unexplained stretch that lasts longer needs attention."""
DEGRADED_AFTER_S = 10.0
"""A channel that is not good for longer is out, and needs attention."""
KEEP_DAYS = 30.0
MAX_MB = 100.0
"""Size of the record of events."""
