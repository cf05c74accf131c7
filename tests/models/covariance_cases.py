"""What tests of the covariance of filtered means share: the noise, the motion and a filter of the bench."""

from beamtouch_models.filters import Mean

NOISE_MM = 0.0045
RATE_HZ = 200.0
PERIOD = 0.098 * RATE_HZ
"""Of the beam of the bench with a weight of 20 N on it, in readings."""
FILTER = Mean("moving-average", 4, spike_mm=6 * NOISE_MM)
