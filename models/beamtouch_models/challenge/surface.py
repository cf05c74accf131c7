"""The simulated surface: the beam of a model's scene as calibrated, its sensors with their errors, and an ADC."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.metadata import Departures, Metadata
from beamtouch_models.physics.beam import influence
from beamtouch_models.physics.motion import Modes
from beamtouch_models.scene import Scene
from beamtouch_models.scene.beam import Beam, changed_beam
from beamtouch_models.surface import Surface


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


TABLE = 1001
"""Number of load positions in the tables of deflections and modes."""
SPARE = 8
"""Readings after everything that a filter looks back on, so that the state has followed them."""


@dataclass(frozen=True)
class SimulatedSurface:
    """A beam at rest under loads, and its sensors."""

    metadata: Metadata
    scene: Scene
    beam: Beam
    sensor_mm: Floats
    """(channels,) true positions."""
    noise_mm: float
    """Standard deviation of a reading, without the steps of the ADC."""
    slowest_period: float
    """In readings; 0 if it is not known."""
    gain: Floats
    """(channels,) standard deviation of the relative gain error."""
    zero_mm: Floats
    """(channels,) standard deviation of the zero."""
    departures: Departures
    influence: CubicSpline
    """From load positions (...) to deflections per newton (..., channels) in mm/N."""
    modes: Modes | None
    """None if the scene does not state the beam's mass."""
    mode_shapes: CubicSpline | None
    """From load positions (...) to the shapes of the modes under the load (..., modes)."""

    @classmethod
    def of(cls, metadata: Metadata) -> Self:
        """Return the surface that a model was made for, with all effects that its scene states.

        Raises
        ------
        SceneError
            The scene in the model cannot be computed.
        """
        surface, departures = Surface.of_model(metadata), metadata.departures
        scene, beam, readings = surface.stated, surface.stated.beam, surface.readings
        gains, zeros_mm = (np.full(len(metadata.layout), value) for value in (readings.gain, readings.floor_mm))
        if metadata.calibration is not None:
            gains, zeros_mm = np.array(metadata.floor.gain), np.array(metadata.floor.zero_mm)
            beam = changed_beam(beam, departures.rigidity, departures.fixity)
        sensor_mm = departures.sensors_mm(metadata.layout_mm, beam.length_mm)
        loads = np.linspace(*scene.contact.position_mm, TABLE)
        step_mm = metadata.sensor.gain_mm_per_count
        modes = Modes.of(beam, scene.contact.width_mm)
        return cls(
            metadata=metadata,
            scene=scene,
            beam=beam,
            sensor_mm=sensor_mm,
            noise_mm=float(np.sqrt(max(0.0, metadata.noise.reading_mm**2 - step_mm**2 / 12))),
            slowest_period=surface.slowest_period,
            gain=gains,
            zero_mm=zeros_mm,
            departures=departures,
            influence=CubicSpline(loads, influence(beam, sensor_mm, loads, scene.contact.width_mm)),
            modes=modes,
            mode_shapes=None if modes is None else CubicSpline(loads, modes.under(loads)),
        )

    def stating(self, stated: Stated) -> Self:
        """Return the surface with the figures that a user states for its sensors."""
        metadata, channels = self.metadata, self.channels
        return replace(
            self,
            metadata=metadata.model_copy(
                update={
                    "noise": metadata.noise.model_copy(update={"reading_mm": stated.noise_mm}),
                    "floor": metadata.floor.model_copy(update={"zero_mm": [stated.zero_mm] * channels}),
                    "sensor": metadata.sensor.model_copy(update={"gain_mm_per_count": stated.step_mm}),
                }
            ),
        )

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.sensor_mm)

    @property
    def min_noise_mm(self) -> float:
        """Noise of a settled sample."""
        return self.metadata.filter.min_noise_mm(self.metadata.noise)

    @property
    def look_back(self) -> int:
        """Number of readings after which nothing before them is in a sample or in the state of the surface."""
        return self.metadata.filter.max_readings + self.decided

    @property
    def decided(self) -> int:
        """Number of readings after which the state of the surface has followed a settled filter."""
        return 2 * self.metadata.filter.window + int(np.ceil(self.slowest_period)) + SPARE

    def under(self, position_mm: Floats, force_n: Floats) -> Floats:
        """Return deflections at rest, (..., channels) in mm, of contacts of the same shape (...)."""
        deflection: Floats = self.influence(position_mm) * force_n[..., None]
        return deflection

    def perfect(self, draws: int) -> SensorErrors:
        """Return sensors without errors."""
        shape = (draws, self.channels)
        return SensorErrors(np.ones(shape), np.zeros(shape), np.ones(shape), np.zeros(shape, np.bool_))

    def honest(self, draws: int, rng: np.random.Generator) -> SensorErrors:
        """Return errors as large as the scene states, or as the calibration left."""
        shape = (draws, self.channels)
        gain, zero_mm = 1 + rng.normal(size=shape) * self.gain, rng.normal(size=shape) * self.zero_mm
        return replace(self.perfect(draws), gain=gain, zero_mm=zero_mm)

    def measured(self, deflection_mm: Floats, errors: SensorErrors) -> Floats:
        """Return what sensors without noise measure of true deflections; both (draws, readings, channels)."""
        shown = self.departures.measure(deflection_mm * np.array(self.departures.gain))
        measured: Floats = shown * errors.gain[:, None] + errors.zero_mm[:, None]
        return measured

    def readings(self, deflection_mm: Floats, errors: SensorErrors, rng: np.random.Generator) -> Floats:
        """Return readings of true deflections, (draws, readings, channels), as the daemon takes them.

        NaN marks a reading that is missing or beyond the sensor's range.
        """
        sensor = self.metadata.sensor
        white = rng.normal(size=deflection_mm.shape)
        if errors.correlation:
            # Begin in the steady state, so that the variance is the same at every reading.
            white[:, 1:] *= np.sqrt(1 - errors.correlation**2)
            white = lfilter([1.0], [1.0, -errors.correlation], white, axis=1)
        noisy = self.measured(deflection_mm, errors) + self.noise_mm * errors.noise[:, None] * white
        step_mm = errors.step_mm or sensor.gain_mm_per_count
        gap = sensor.standoff_mm - noisy
        gap = sensor.offset_mm + np.rint((gap - sensor.offset_mm) / step_mm) * step_mm
        low, high = sensor.range_mm
        good = (gap >= low) & (gap <= high) & ~errors.missing[:, None]
        tare_mm = errors.tare_mm[:, None] if isinstance(errors.tare_mm, np.ndarray) else errors.tare_mm
        return np.where(good, sensor.standoff_mm - gap - tare_mm, np.nan)
