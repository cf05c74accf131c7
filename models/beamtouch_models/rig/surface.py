"""The virtual surface: turns a load into the counts that a device would send. Pure; no I/O."""

import math

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import Metadata, Sensor
from beamtouch_models.physics.beam import influence_matrix
from beamtouch_models.physics.motion import Following, damping_of, first_frequency_hz
from beamtouch_models.rig.faults import Faults
from beamtouch_models.rig.imperfections import Imperfections
from beamtouch_models.rig.script import Load
from beamtouch_models.scene import Scene
from beamtouch_models.scene.beam import changed_beam
from beamtouch_models.surface import Surface

PERFECT = Imperfections()


class Ringing:
    """The motion of a surface in its first mode, as the price of dynamics assumes, from one conversion to the next."""

    def __init__(self, frequency_hz: float, damping_ratio: float) -> None:
        self._omega, self._damping_ratio = 2 * math.pi * frequency_hz, damping_ratio
        self._last: tuple[float, Following] | None = None

    def at(self, seconds: float, static: Floats) -> Floats:
        """Return the deflections (channels,) at a time [s] that is not before the last one.

        The load at a conversion is assumed to act since the previous conversion, so that a mode much faster than the
        conversions follows at once. At the first conversion the beam is at rest.
        """
        before, followed = self._last or (seconds, Following(static, self._damping_ratio))
        self._last = (seconds, followed)
        return followed.step(self._omega * max(0.0, seconds - before), static, static)


def ringing_of(surface: Surface, damping_ratio: float | None = None) -> Ringing | None:
    """Return the ringing of a surface, with the damping that its scene states or assumes unless another one is given.

    None, and deflections follow at once, if the price of ringing behind the filter is negligible, or if the scene does
    not give density, width and thickness, which set the frequency; with a damping ratio, SceneError then.
    """
    beam = surface.stated.beam
    frequency_hz = first_frequency_hz(beam)
    if frequency_hz is None:
        if damping_ratio is None:
            return None
        message = (
            "damping_ratio needs beam.density_kg_m3 or beam.material, beam.width_mm and beam.thickness_mm in the scene"
        )
        raise SceneError(message)
    if any(effect.name == "dynamics" and effect.verdict == "out" for effect in surface.effects):
        return None
    return Ringing(frequency_hz, damping_of(beam) if damping_ratio is None else damping_ratio)


class VirtualSurface:
    """A beam with its sensors, their characteristic and noise, and an ADC; SceneError if they do not fit together."""

    def __init__(
        self,
        scene: Scene,
        model: Metadata,
        seed: int,
        imperfections: Imperfections = PERFECT,
        *,
        faults: Faults | None = None,
        rings: bool = True,
    ) -> None:
        self.sensor = model.sensor
        self.channels = len(model.layout)
        self._departures = departures = imperfections.departures(self.channels)
        self._sensor_mm = model.layout_mm + np.array(departures.position_offset_mm)
        if not all(0 <= position <= scene.beam.length_mm for position in self._sensor_mm):
            message = "position_offset_mm moves a sensor off the beam"
            raise SceneError(message)
        beam = changed_beam(scene.beam, departures.rigidity, departures.fixity)
        self._scene = scene.model_copy(update={"beam": beam})
        self._noise_mm = Surface.of(scene, model.filter).readings.sensor_mm
        self._rng = np.random.default_rng(seed)
        self._faults = faults or Faults([channel.name for channel in model.layout])
        self._ringing = (
            ringing_of(Surface.of(self._scene, model.filter), imperfections.damping_ratio) if rings else None
        )

    def counts(self, load: Load, seconds: float) -> list[int]:
        """Convert all channels once under a load and return their counts (channels,).

        `seconds` must not lie before the previous conversion.
        """
        outputs = np.array(self.outputs(load, seconds))
        return [int(count) for count in _converted(self.sensor, outputs)]

    def outputs(self, load: Load, seconds: float) -> list[float]:
        """Return the sensor outputs (channels,) under a load, 0 to 1 of the ADC's scale; arguments as `counts`."""
        outputs = output_of_gap(self.sensor, self._noisy_gap_mm(load, seconds))
        changed: list[float] = self._faults.change(outputs, seconds).tolist()
        return changed

    def _noisy_gap_mm(self, load: Load, seconds: float) -> Floats:
        static = self._static_mm(load)
        deflection = static if self._ringing is None else self._ringing.at(seconds, static)
        gap = self.sensor.standoff_mm - self._departures.measure(np.array(self._departures.gain) * deflection)
        return gap + self._rng.normal(scale=self._noise_mm, size=gap.shape)

    def _static_mm(self, load: Load) -> Floats:
        """Return the deflections (channels,) of the beam at rest under a load."""
        if load.position_mm is None:
            return np.zeros(self.channels)
        deflection: Floats = load.force_n * influence_matrix(self._scene, self._sensor_mm, load.position_mm)[0]
        return deflection


def counts_of_gap(sensor: Sensor, gap_mm: Floats) -> NDArray[np.int64]:
    """Return the counts of a proximity sensor with its ADC."""
    return _converted(sensor, output_of_gap(sensor, gap_mm))


def output_of_gap(sensor: Sensor, gap_mm: Floats) -> Floats:
    """Return the output of a proximity sensor, 0 to 1, with the characteristic of the paper's figure 2.

    The linear range takes the middle 80 % of the scale; beyond it the output approaches the end of the scale.
    """
    full_scale = 2**sensor.adc_bits - 1
    linear = (gap_mm - sensor.offset_mm) / sensor.gain_mm_per_count / full_scale
    inside = np.clip(linear, 0.1, 0.9)
    levelled: Floats = inside + 0.1 * np.tanh((linear - inside) / 0.1)
    return levelled


def _converted(sensor: Sensor, outputs: Floats) -> NDArray[np.int64]:
    """Return the counts of an ADC for outputs of 0 to 1."""
    counts: NDArray[np.int64] = np.rint(outputs * (2**sensor.adc_bits - 1)).astype(np.int64)
    return counts
