"""The errors of simulated sensors, and the figures that a user states for them."""

from dataclasses import dataclass

from beamtouch_models.arrays import Bools, Floats


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the sensors in each draw; fields have shape (draws, channels) or broadcast to it."""

    gain: Floats
    """Measured over true deflection."""
    zero_mm: Floats
    noise: Floats
    """Noise over that of the model."""
    missing: Bools
    correlation: float = 0.0
    """Correlation of the noise of consecutive readings."""
    step_mm: float | None = None
    """Step of the ADC, instead of the model's."""
    tare_mm: Floats | float = 0.0
    """Deflection that the sensors showed at rest, and that the tare takes out."""


@dataclass(frozen=True)
class Stated:
    """Figures that `beamtouch-daemon noise` prints for sensors whose noise is not what the model assumes."""

    noise_mm: float
    """Noise of a reading, in the daemon's configuration."""
    zero_mm: float
    """Error of the zero, in the floor of a model that is built again."""
    step_mm: float
    """Step of the ADC, in the daemon's configuration."""
