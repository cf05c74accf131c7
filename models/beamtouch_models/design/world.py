"""The world of a simulated surface: its structure with departures, how it moves, its sensors, and their ADC.

The rig plays it in real time; `challenge` and the errors since a touch play it for many draws at once. It has all
effects that the scene states, also those whose price is negligible.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from beamtouch_common.units import MM, direction_of
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.physics.measured_structure import MeasuredStructure
from beamtouch_models.design.physics.motion import GRAVITY, M_PER_MM, Following, Modes, beyond_rest, damping_of, swings
from beamtouch_models.design.physics.place_table import PlaceTable
from beamtouch_models.design.physics.structure import Structure, changed, influence, structure_of
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.errors import SceneError
from beamtouch_models.places import Extent
from beamtouch_models.runtime.departures import Departures
from beamtouch_models.runtime.metadata_parts import Sensor

TABLE = 1001
"""Number of load positions in the tables of deflections and modes."""
Tabled = Callable[[Any], Floats]
"""From numbers or arrays."""
LINEAR = 0.1, 0.9
"""The part of the ADC's scale that the linear range of a sensor takes."""


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the sensors in each draw; fields have shape (draws, channels) or broadcast to it."""

    gain: Floats
    """Measured over true deflection."""
    zero_mm: Floats
    noise: Floats
    """Noise over that of the model."""
    missing: Bools

    @classmethod
    def none(cls, draws: int, channels: int) -> Self:
        """Return sensors without errors."""
        shape = (draws, channels)
        return cls(np.ones(shape), np.zeros(shape), np.ones(shape), np.zeros(shape, np.bool_))


@dataclass(frozen=True)
class World:
    """A structure under loads, and its sensors. Tables are computed when they are first asked for."""

    structure: Structure
    """With its departures."""
    width_mm: float
    """Length over which a load presses."""
    extent: Extent
    """Places of the loads."""
    sensor: Sensor
    sensor_mm: Floats
    """(channels,) true positions; on a plate (channels, 2) places."""
    noise_mm: float
    """Standard deviation of a reading, without the steps of the ADC."""
    departures: Departures
    towards: float = direction_of(MM)
    """Change of a sensor's value with its deflection: -1 for a gap."""

    @classmethod
    def of(
        cls,
        scene: Scene,
        sensor: Sensor,
        layout_mm: Floats,
        noise_mm: float,
        departures: Departures | None = None,
        extent: Extent | None = None,
    ) -> Self:
        """Return the world of a scene.

        Parameters
        ----------
        scene : the scene as stated
        sensor, layout_mm : the sensor of each channel, and their stated positions (channels,)
        noise_mm : noise of a reading, without the steps of the ADC
        departures : of the real surface from the scene; None: there are none
        extent : places of the loads; None: those of the scene's contacts

        Raises
        ------
        SceneError
            The beam cannot be computed. So do the tables.
        """
        off = departures or Departures.none(len(layout_mm))
        structure = changed(structure_of(scene), off)
        sensor_mm = off.sensors_mm(layout_mm, scene.size_mm)
        places = extent or Extent(scene.contact.ranges_mm)
        return cls(
            structure, scene.contact.width_mm, places, sensor, sensor_mm, noise_mm, off, direction_of(scene.unit)
        )

    def draw(self, rng: np.random.Generator) -> "World":
        """Draw a world that agrees with what was measured of the structure; that of a beam is this one."""
        return (
            replace(self, structure=self.structure.draw(rng)) if isinstance(self.structure, MeasuredStructure) else self
        )

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(self.sensor_mm)

    @property
    def reading_mm(self) -> float:
        """Standard deviation of a reading; a step of q adds q / sqrt(12)."""
        return math.hypot(self.noise_mm, self.sensor.gain_mm_per_count / math.sqrt(12))

    @cached_property
    def influence(self) -> Tabled:
        """From load positions (...) to deflections per newton (..., channels) in mm/N; on a plate from (..., 2)."""
        return self._tabled(lambda loads: influence(self.structure, self.sensor_mm, loads, self.width_mm))

    def _tabled(self, values_at: Callable[[Floats], Floats]) -> Tabled:
        """Return a function of load positions, or of places on a plate, from a table of it."""
        if self.extent.axes > 1:
            return PlaceTable.over(self.extent, values_at)
        loads = np.linspace(*self.extent.range_mm, TABLE)
        line: Tabled = CubicSpline(loads, values_at(loads))
        return line

    @cached_property
    def modes(self) -> Modes | None:
        """The modes of the beam or plate; None if the scene does not state its mass, or the structure is none."""
        return Modes.of(self.structure, self.width_mm) if isinstance(self.structure, Beam | Plate) else None

    @property
    def damping_ratio(self) -> float:
        """Damping ratio of the modes of the beam or plate; SceneError if the structure is none."""
        if not isinstance(self.structure, Beam | Plate):
            raise SceneError("measured: a table does not tell how the structure rings; leave out what rings")
        return damping_of(self.structure)

    @cached_property
    def mode_shapes(self) -> Tabled | None:
        """From load positions (...) to the shapes of the modes under the load (..., modes); None without a mass."""
        return None if self.modes is None else self._tabled(self.modes.under)

    @cached_property
    def share_mm(self) -> Floats:
        """(channels, modes), deflection of each sensor for what a mode follows; no modes without a mass."""
        if self.modes is None:
            return np.zeros((self.channels, 0))
        share: Floats = self.modes.at(self.sensor_mm) * self.modes.square_s2 / M_PER_MM
        return share

    def under(self, position_mm: Floats | float, force_n: Floats | float) -> Floats:
        """Return deflections at rest, (..., channels) in mm, of contacts of the same shape (...).

        Places on a plate are (..., 2).
        """
        deflection: Floats = self.influence(np.asarray(position_mm)) * np.asarray(force_n)[..., None]
        return deflection

    def ringing_mm(
        self, position_mm: Floats, force_n: Floats, seconds: Floats, *, weighs: bool = False, lasting_s: float = 0.0
    ) -> Floats:
        """Return what ringing adds to the deflections at rest after loads that come, (loads, readings, channels) in mm.

        Parameters
        ----------
        position_mm, force_n : (loads,); places on a plate are (loads, 2)
        seconds : (loads, readings) since the load came
        weighs : whether the load is a weight that swings with the beam
        lasting_s : time in which the load grows evenly; 0: it comes at once

        Raises
        ------
        ValueError
            The mass of the beam is not stated.
        """
        modes = self.modes
        if modes is None:
            raise ValueError("a beam without a mass does not ring")
        weight_kg, shapes = force_n / GRAVITY * weighs, modes.under(position_mm)
        loaded = swings(modes.at(self.sensor_mm), shapes, modes.square_s2, force_n, weight_kg)
        return loaded.ringing_mm(seconds, self.damping_ratio, lasting_s)

    def inertia_mm(self, path_mm: Floats, force_n: Floats, step_s: float) -> Floats:
        """Return what inertia adds to the deflections at rest under a load that moves, (draws, steps, channels) in mm.

        The load is at `path_mm` (draws, steps), on a plate (draws, steps, 2), the steps are `step_s` apart, and the
        force (draws,) stays. The load should hardly move in a step. A structure whose mass is not stated has no
        inertia.
        """
        modes, shapes = self.modes, self.mode_shapes
        if modes is None or shapes is None:
            return np.zeros((*path_mm.shape[:2], self.channels))
        target = shapes(path_mm) * force_n[:, None, None]
        away = beyond_rest(target, step_s, 1 / np.sqrt(modes.square_s2), self.damping_ratio)
        added: Floats = away @ self.share_mm.T
        return added

    def measured(self, deflection_mm: Floats, errors: SensorErrors) -> Floats:
        """Return what sensors without noise measure of true deflections; both (draws, readings, channels)."""
        shown = self.departures.measure(deflection_mm * np.array(self.departures.gain))
        measured: Floats = shown * errors.gain[:, None] + errors.zero_mm[:, None]
        return measured

    def outputs(self, deflection_mm: Floats, errors: SensorErrors, rng: np.random.Generator) -> Floats:
        """Return the noisy outputs of the sensors, 0 to 1 of the ADC's scale; both (draws, readings, channels)."""
        white = rng.normal(size=deflection_mm.shape)
        noisy = self.measured(deflection_mm, errors) + self.noise_mm * errors.noise[:, None] * white
        return output_of_gap(self.sensor, self.sensor.standoff_mm + self.towards * noisy)

    def readings(self, deflection_mm: Floats, errors: SensorErrors, rng: np.random.Generator) -> Floats:
        """Return readings of true deflections, (draws, readings, channels), as the daemon takes them.

        NaN marks a reading that is missing or beyond the sensor's range.
        """
        sensor, (low, high) = self.sensor, self.sensor.range_mm
        full_scale = (high - low) / (LINEAR[1] - LINEAR[0]) / sensor.gain_mm_per_count
        counts = np.rint(self.outputs(deflection_mm, errors, rng) * full_scale)
        gap = sensor.offset_mm + sensor.gain_mm_per_count * counts
        good = (gap >= low) & (gap <= high) & ~errors.missing[:, None]
        return np.where(good, self.towards * (gap - sensor.standoff_mm), np.nan)


class Motion:
    """The beam of a world from one instant to the next, at rest at the first one."""

    def __init__(self, world: World, *, rings: bool = True) -> None:
        """Make the tables of the world. The beam follows loads at once unless it `rings` and its mass is stated."""
        self._still, modes = world.influence, world.modes if rings else None
        self._shapes = world.mode_shapes if rings else None
        if modes is not None:
            self._share_mm, self._second_per_angle = world.share_mm, np.sqrt(modes.square_s2)
            self._damping_ratio = world.damping_ratio
        self._last: tuple[float, Following] | None = None

    def at(self, seconds: float, position_mm: float | Floats, force_n: float) -> Floats:
        """Return the deflections (channels,) under a load at a time [s] that is not before the last one.

        On a plate the place is (2,).

        The load at an instant is assumed to act since the previous one, so that a mode much faster than the instants
        follows at once.
        """
        place_mm = np.asarray(position_mm)
        still: Floats = self._still(place_mm) * force_n
        if self._shapes is None:
            return still
        target = self._shapes(place_mm) * force_n
        before_s, followed = self._last or (seconds, Following(target, self._damping_ratio))
        self._last = (seconds, followed)
        away = followed.step(max(0.0, seconds - before_s) / self._second_per_angle, target, target) - target
        moved: Floats = still + self._share_mm @ away
        return moved


def output_of_gap(sensor: Sensor, gap_mm: Floats) -> Floats:
    """Return the output of a proximity sensor, 0 to 1, with the characteristic of the paper's figure 2.

    The linear range takes the middle 80 % of the scale; beyond it the output approaches the end of the scale.
    """
    low, high = LINEAR
    linear = low + (high - low) * (gap_mm - sensor.range_mm[0]) / (sensor.range_mm[1] - sensor.range_mm[0])
    inside = np.clip(linear, low, high)
    levelled: Floats = inside + low * np.tanh((linear - inside) / low)
    return levelled


def counts_of_output(sensor: Sensor, outputs: Floats) -> NDArray[np.int64]:
    """Return the counts of an ADC for outputs of 0 to 1."""
    counts: NDArray[np.int64] = np.rint(outputs * (2**sensor.adc_bits - 1)).astype(np.int64)
    return counts
