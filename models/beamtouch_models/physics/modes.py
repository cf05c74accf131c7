"""Modes of a beam, also with a weight lying on it: the motion that a changing load adds to the deflection at rest.

The beam's mass is taken as points. Their flexibility is the influence matrix, so any supports, sections and foundation
have modes. Modes are normalised to a mass of 1 kg; the deflection w of mode k at x follows a force F at a as

    q'' + 2 zeta omega q' + omega^2 q = F shape_k(a),   w = shape_k(x) q.

A weight m at a adds m shape(a) shape(a)' to the mass of the modes (Meirovitch, Fundamentals of Vibrations, 2001,
sec. 8.5).
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats
from beamtouch_models.physics.beam import influence
from beamtouch_models.physics.dynamics import point_masses
from beamtouch_models.scene.beam import Beam

MODES = 24
"""Modes that are followed; of the rest, a sudden load on a slender beam excites less than 1e-4 of its deflection."""
MIN_SQUARE = 1e-12
"""Smallest square of a period, relative to the longest, that rounding leaves of the flexibility."""
M_PER_MM = 1e-3


@dataclass(frozen=True)
class Modes:
    """The first modes of a beam."""

    beam: Beam
    width_mm: float
    """Length over which a load presses."""
    place_mm: Floats
    """(points,) places of the point masses."""
    moved: Floats
    """(points, modes) mass times shape over the square of the angular frequency, [kg^(1/2) s^2]."""
    square_s2: Floats
    """(modes,) 1 / omega^2, longest first."""

    @classmethod
    def of(cls, beam: Beam, width_mm: float) -> Self | None:
        """Return the modes of a beam; None if its mass is not stated."""
        points = point_masses(beam)
        if points is None:
            return None
        place, mass = points
        root = np.sqrt(mass)
        flexibility = influence(beam, place, place) * M_PER_MM * root[:, None] * root
        squares, vectors = np.linalg.eigh((flexibility + flexibility.T) / 2)
        kept = np.flatnonzero(squares > MIN_SQUARE * squares[-1])[: -MODES - 1 : -1]
        moved = root[:, None] * vectors[:, kept] / squares[kept]
        return cls(beam, width_mm, place, moved, squares[kept])

    def at(self, sensor_mm: Floats) -> Floats:
        """Return the shapes at points of the beam, (points, modes) in kg^(-1/2)."""
        shapes: Floats = influence(self.beam, self.place_mm, sensor_mm) * M_PER_MM @ self.moved
        return shapes

    def under(self, load_mm: Floats) -> Floats:
        """Return the mean shapes under loads, over their width, (loads, modes) in kg^(-1/2)."""
        shapes: Floats = influence(self.beam, self.place_mm, load_mm, self.width_mm) * M_PER_MM @ self.moved
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
        found = np.empty((*seconds.shape, self.share_mm.shape[1]))
        for index, (omega, share) in enumerate(zip(self.omega, self.share_mm, strict=True)):
            found[index] = swing(seconds[index][:, None], omega, damping_ratio, lasting_s) @ share.T
        return found


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
    found, followed = np.zeros(target.shape), Following(target[:, 0], damping_ratio)
    for step in range(1, target.shape[1]):
        found[:, step] = followed.step(omega * step_s, target[:, step - 1], target[:, step]) - target[:, step]
    return found


class Following:
    """Oscillators that follow targets, from rest at the first ones.

    Their complex state z follows dz/d(omega t) = pole z + target; its imaginary part, scaled, is the deflection.
    """

    def __init__(self, target: Floats, damping_ratio: float) -> None:
        self._damping_ratio, self._pole = damping_ratio, _pole(damping_ratio)
        self._state = -target / self._pole

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
