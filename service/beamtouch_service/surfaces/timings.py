"""How long things take on one surface."""

from beamtouch_service.surfaces.inference import Durations

BATCH_BUCKETS_S = (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 0.1, 0.2, 0.5, 1.0, 10.0)
"""Upper ends [s]: from a sample on loopback to the longest that a body may take."""
AGE_BUCKETS_S = (1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Upper ends [s], around the limits of age that make sense."""


class Timings:
    """Histograms since the start."""

    def __init__(self) -> None:
        self.inference_s = Durations()
        """Per estimate."""
        self.batch_s = Durations(BATCH_BUCKETS_S)
        """From the head of a batch to its receipt, of those that were taken."""
        self.arrival_age_s = Durations(AGE_BUCKETS_S)
        """Ages of the newest sample when its batch arrived, of those that moved the present."""
