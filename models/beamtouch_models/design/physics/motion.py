"""Motion of a beam or a plate: its natural frequencies and modes, also with a weight on it, and the ringing of a load.

The mass is taken as points. Their flexibility is the influence matrix, so any supports, sections and foundation have
modes. Modes are normalised to a mass of 1 kg; the deflection w of mode k at x follows a force F at a as

    q'' + 2 zeta omega q' + omega^2 q = F shape_k(a),   w = shape_k(x) q.

A weight m at a adds m shape(a) shape(a)' to the mass of the modes (Meirovitch, Fundamentals of Vibrations, 2001,
sec. 8.5).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.closed_forms import span_of
from beamtouch_models.design.physics.solid import Solid, influence, loads_of
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import SMALLEST_NORMAL, Beam
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.errors import SceneError, require
from beamtouch_models.places import grid_of
from beamtouch_models.runtime.metadata_parts import FilterChoice

DAMPING_RATIO = 0.01
"""Assumed if a scene states none: a bare metal beam on its supports; Blevins, Flow-Induced Vibration, ch. 8."""
# First roots of the frequency equations; Blevins, Formulas for Natural Frequency and Mode Shape, 1979, table 8-1.
FIRST_ROOT = {
    "simply-supported": math.pi,
    "cantilever": 1.8751040687119611,
    "fixed-fixed": 4.7300407448627040,
    "propped": 3.9266023120479187,
}
GRAVITY = 9.80665
POINTS = 400
"""Point masses that represent the beam if there is no closed form; they give the frequency to about 1e-4."""
EXCITED = 4
"""Modes that a sudden load excites noticeably: its deflection in mode k is about 1/k^4 of that in the first."""
FEWEST = 6
"""Point masses along the shorter side of a plate, at least."""
MODES = 24
"""Modes that are followed; of the rest, a sudden load on a slender beam excites less than 1e-4 of its deflection."""
MIN_SQUARE = 1e-12
"""Smallest square of a period, relative to the longest, that rounding leaves of the flexibility."""
M_PER_MM = 1e-3


def damping_of(solid: Solid) -> float:
    """Return the damping of the modes over critical damping, as stated or assumed."""
    return DAMPING_RATIO if solid.damping_ratio is None else solid.damping_ratio


def first_frequency_hz(solid: Solid) -> float | None:
    """Return the first natural frequency in Hz; None if the scene does not state the mass.

    Without a closed form it comes from the influence matrix: for any supports, the largest eigenvalue of flexibility
    times mass is 1/omega^2.
    """
    if point_masses(solid) is None:
        return None
    closed = _closed_form_hz(solid) if isinstance(solid, Beam) else None
    frequency = float(_frequencies_hz(solid)[0]) if closed is None else closed
    if not SMALLEST_NORMAL <= frequency < math.inf:
        raise SceneError("beam: its natural frequency cannot be computed; check length, rigidity and density")
    return frequency


def _closed_form_hz(beam: Beam) -> float | None:
    """Return the first natural frequency of a uniform single span; None of other beams."""
    mass, span = _line_mass(beam), span_of(beam, 0.0, beam.length_mm)
    if mass is None or span is None or np.ptp(mass) > 0:
        return None
    ratio = beam.rigidity_n_mm2 * 1e3 / float(mass[0])  # mm^4/s^2: a newton is 1000 kg mm/s^2
    return FIRST_ROOT[span.form] ** 2 / (2 * math.pi) * math.sqrt(ratio) / beam.length_mm / beam.length_mm


def frequency_hz(scene: Scene) -> float:
    """Return the first natural frequency of a scene's beam or plate, in Hz.

    Raises
    ------
    SceneError
        The scene does not state its mass.

    Examples
    --------
    >>> round(frequency_hz(scene), 1)
    44.0
    """
    require(scene, Scene, "scene", "what read_scene or make_scene returns")
    first_hz = first_frequency_hz(scene.solid)
    if first_hz is None:
        if scene.plate is not None:
            raise SceneError("plate: state density_kg_m3; it sets its frequency")
        raise SceneError("beam: state density_kg_m3, width_mm and thickness_mm; they set its frequency")
    return first_hz


def laden_period_s(scene: Scene) -> float | None:
    """Return the period of a scene's beam or plate with a weight on it, in s; None without its mass.

    The largest force of the scene is taken as a weight where it yields most. The squares of the periods without the
    weight and of the weight add up (Dunkerley, On the whirling and vibration of shafts, Phil. Trans. A 185, 1894),
    which is never too short.
    """
    first_hz = first_frequency_hz(scene.solid)
    return None if first_hz is None else _laden_s(scene, first_hz)


def _laden_s(scene: Scene, first_hz: float) -> float:
    loads = loads_of(scene)
    yielding_m_per_n = 1e-3 * float(np.diag(influence(scene.solid, loads, loads)).max())
    weight_kg = scene.contact.force_range_n[1] / GRAVITY
    return math.hypot(1 / first_hz, 2 * math.pi * math.sqrt(weight_kg * yielding_m_per_n))


def slowest_period_ms(scene: Scene) -> float | None:
    """Return the longest period in which the readings of a scene's beam or plate seem to swing, in ms.

    None if the scene does not state its mass.

    A weight on it makes it slower, as `laden_period_s` says. A mode that swings faster than half the rate of the
    readings seems to swing at the difference to a multiple of that rate, for as long as it rings. Close to half the
    rate, readings fall on alternate sides, and their amplitude seems to swing at the difference to half the rate.
    """
    solid, rate_hz = scene.solid, scene.sensors.rate_hz
    first_hz = first_frequency_hz(solid)
    if first_hz is None:
        return None
    periods_s = [_laden_s(scene, first_hz)]
    for frequency_hz in (first_hz, *_frequencies_hz(solid)[1:EXCITED].tolist()):
        decays_per_s = damping_of(solid) * 2 * math.pi * frequency_hz
        apparent_hz = abs(frequency_hz - round(frequency_hz / rate_hz) * rate_hz)
        beat_hz = min(apparent_hz, rate_hz / 2 - apparent_hz)
        periods_s.append(1 / max(beat_hz, decays_per_s))
    return 1e3 * max(periods_s)


def sag_mm(solid: Solid) -> float | None:
    """Return the largest deflection under the own weight, in mm; None if the mass is not stated."""
    points = point_masses(solid)
    if points is None:
        return None
    place, point_mass = points
    return float(np.abs(GRAVITY * point_mass @ influence(solid, place, place)).max())


def _line_mass(beam: Beam) -> Floats | None:
    """Return the mass per length of each section in kg/mm; None if the scene does not state it."""
    areas = [section.area_mm2 for section in beam.sections]
    if beam.mass_density_kg_m3 is None or None in areas:
        return None
    mass = beam.mass_density_kg_m3 * 1e-9 * np.array(areas, dtype=np.float64)
    if not np.all((mass >= SMALLEST_NORMAL) & (mass < np.inf)):
        raise SceneError("beam: its mass cannot be computed; check density, width and thickness")
    return mass


def point_masses(solid: Solid) -> tuple[Floats, Floats] | None:
    """Return the mass as points: places in mm, and masses in kg (points,); None if it is not stated.

    Places of a beam are positions (points,), those of a plate (points, 2).
    """
    if isinstance(solid, Plate):
        density = solid.mass_density_kg_m3
        return None if density is None else _points_of_plate(solid, density * 1e-9 * solid.thickness_mm)
    mass = _line_mass(solid)
    return None if mass is None else _points(solid, mass)


def _points(beam: Beam, line_mass: Floats) -> tuple[Floats, Floats]:
    place = (np.arange(POINTS) + 0.5) / POINTS * beam.length_mm
    section = np.searchsorted([section.to_mm for section in beam.sections], place)
    return place, line_mass[section] * (beam.length_mm / POINTS)


def _points_of_plate(plate: Plate, area_mass: float) -> tuple[Floats, Floats]:
    size = np.array(plate.size_mm)
    along = np.maximum(FEWEST, np.rint(size * math.sqrt(POINTS / size.prod()))).astype(int)
    place = grid_of([(np.arange(count) + 0.5) / count * length for count, length in zip(along, size, strict=True)])
    return place, np.full(len(place), area_mass * float(size.prod()) / len(place))


def _flexibility_s2(solid: Solid, place_mm: Floats, mass_kg: Floats) -> Floats:
    """Return the flexibility of point masses, each over the roots of its masses; its eigenvalues are 1 / omega^2."""
    root = np.sqrt(mass_kg)
    flexibility = influence(solid, place_mm, place_mm) * M_PER_MM * root[:, None] * root
    symmetric: Floats = (flexibility + flexibility.T) / 2
    return symmetric


@lru_cache(maxsize=4)  # a scene is asked for them several times
def _frequencies_hz(solid: Solid) -> Floats:
    """Return the natural frequencies in Hz, lowest first; those of modes that do not move are inf."""
    if (points := point_masses(solid)) is None:
        raise SceneError("its mass is not stated")
    squares = np.maximum(np.linalg.eigvalsh(_flexibility_s2(solid, *points))[::-1], 0.0)
    with np.errstate(divide="ignore"):
        frequencies: Floats = 1 / (2 * math.pi * np.sqrt(squares))
    return frequencies


def ringing_after_filter(frequency_hz: float, damping_ratio: float, chosen: FilterChoice, rate_hz: float) -> float:
    """Return the share of a sudden load's deflection that still rings once the filter has settled on that load.

    All motion is assumed to be in the first mode. It decays during the settling time, and a mean of N readings passes
    |sin(pi f N/rate) / (N sin(pi f/rate))| of it.
    """
    decay = math.exp(-damping_ratio * 2 * math.pi * frequency_hz * chosen.settling_ms / 1000)
    phase = math.pi * frequency_hz / rate_hz
    passed = 1.0
    if abs(math.sin(phase)) > 1e-9:
        passed = min(1.0, abs(math.sin(chosen.window * phase) / (chosen.window * math.sin(phase))))
    return decay * passed


@dataclass(frozen=True)
class Modes:
    """The first modes of a beam or a plate."""

    solid: Solid
    width_mm: float
    """Length over which a load presses."""
    place_mm: Floats
    """(points,) or (points, 2) places of the point masses."""
    moved: Floats
    """(points, modes) mass times shape over the square of the angular frequency, [kg^(1/2) s^2]."""
    square_s2: Floats
    """(modes,) 1 / omega^2, longest first."""

    @classmethod
    def of(cls, solid: Solid, width_mm: float) -> Self | None:
        """Return the modes of a beam or a plate; None if its mass is not stated."""
        points = point_masses(solid)
        if points is None:
            return None
        place, mass = points
        squares, vectors = np.linalg.eigh(_flexibility_s2(solid, place, mass))
        modes = np.flatnonzero(squares > MIN_SQUARE * squares[-1])[: -MODES - 1 : -1]
        moved = np.sqrt(mass)[:, None] * vectors[:, modes] / squares[modes]
        return cls(solid, width_mm, place, moved, squares[modes])

    def at(self, sensor_mm: Floats) -> Floats:
        """Return the shapes at points, (points, modes) in kg^(-1/2)."""
        shapes: Floats = influence(self.solid, self.place_mm, sensor_mm) * M_PER_MM @ self.moved
        return shapes

    def under(self, load_mm: Floats) -> Floats:
        """Return the mean shapes under loads, over their width, (loads, modes) in kg^(-1/2)."""
        shapes: Floats = influence(self.solid, self.place_mm, load_mm, self.width_mm) * M_PER_MM @ self.moved
        return shapes


@dataclass(frozen=True)
class Swings:
    """The modes of a beam with its loads, each an oscillator."""

    omega: Floats
    """(loads, modes) angular frequencies in 1/s."""
    share_mm: Floats
    """(loads, sensors, modes) deflection at rest of each sensor in each mode."""

    def ringing_mm(self, seconds: Floats, damping_ratio: float, lasting_s: float = 0.0) -> Floats:
        """Return the deflection beyond that at rest after a load that grows evenly for `lasting_s`.

        `seconds` (loads, readings) count from its beginning. Returns (loads, readings, sensors) in mm.
        """
        ringing_mm = np.empty((*seconds.shape, self.share_mm.shape[1]))
        for index, (omega, share) in enumerate(zip(self.omega, self.share_mm, strict=True)):
            ringing_mm[index] = swing(seconds[index][:, None], omega, damping_ratio, lasting_s) @ share.T
        return ringing_mm


def swings(sensor_shapes: Floats, load_shapes: Floats, square_s2: Floats, force_n: Floats, weight_kg: Floats) -> Swings:
    """Return the oscillators of loads.

    Parameters
    ----------
    sensor_shapes : (sensors, modes)
    load_shapes : (loads, modes)
    square_s2 : (modes,), of the beam alone
    force_n, weight_kg : (loads,), force of each load, and the mass that moves with the beam
    """
    root = np.sqrt(square_s2)
    scaled = load_shapes * root
    squares, vectors = np.linalg.eigh(
        np.diag(square_s2) + weight_kg[:, None, None] * scaled[:, :, None] * scaled[:, None]
    )
    drive = np.einsum("lkm,lk->lm", vectors, scaled) * force_n[:, None]
    share = np.einsum("sk,lkm->lsm", sensor_shapes * root, vectors) * drive[:, None]
    return Swings(1 / np.sqrt(squares), share / M_PER_MM)


def swing(seconds: Floats, omega: Floats | float, damping_ratio: float, lasting_s: float = 0.0) -> Floats:
    """Return the motion of oscillators about what they follow, relative to their deflection at rest.

    `seconds` count from the beginning of a load that comes at once, or grows evenly for `lasting_s`; they and the
    angular frequencies `omega` broadcast.
    """
    pole, since = _pole(damping_ratio), np.maximum(seconds, 0.0)
    turned = np.exp(pole * (omega * since))
    if lasting_s == 0:
        return np.where(seconds >= 0, _deflection(turned / pole, damping_ratio), 0.0)
    before = np.exp(pole * (omega * np.maximum(seconds - lasting_s, 0.0)))
    return _deflection((turned - before) / (pole * pole * omega * lasting_s), damping_ratio)


def beyond_rest(target: Floats, step_s: float, omega: Floats, damping_ratio: float) -> Floats:
    """Return how far oscillators that began at rest are from a target that moves, in the target's unit.

    The target (loads, steps, modes) is straight between its steps, which are `step_s` apart; then the result is exact.
    `omega` (modes,) are angular frequencies in 1/s.
    """
    deviation, followed = np.zeros(target.shape), Following(target[:, 0], damping_ratio)
    for step in range(1, target.shape[1]):
        deviation[:, step] = followed.step(omega * step_s, target[:, step - 1], target[:, step]) - target[:, step]
    return deviation


class Following:
    """Oscillators that follow targets, from rest at the first ones.

    Their complex state z follows dz/d(omega t) = pole z + target; its imaginary part, scaled, is the deflection.
    """

    def __init__(self, target: Floats, damping_ratio: float) -> None:
        self._damping_ratio, self._pole = damping_ratio, _pole(damping_ratio)
        self._state: NDArray[np.complex128] = -target.astype(np.complex128) / self._pole

    def step(self, angle: Floats | float, before: Floats, after: Floats) -> Floats:
        """Return the deflections once the targets have gone straight from `before` to `after`; exact for any step.

        `angle` is the angular frequency times the length of the step.
        """
        turned = self._pole * angle
        held = np.expm1(turned) / self._pole
        rising = (held - angle) / np.where(turned == 0, 1.0, turned)
        self._state = np.exp(turned) * self._state + before * held + (after - before) * rising
        return _deflection(self._state, self._damping_ratio)


def _pole(damping_ratio: float) -> complex:
    """Return the pole of an oscillator over its angular frequency."""
    return complex(-damping_ratio, math.sqrt(1 - damping_ratio**2))


def _deflection(state: NDArray[np.complex128], damping_ratio: float) -> Floats:
    deflection: Floats = state.imag / math.sqrt(1 - damping_ratio**2)
    return deflection
