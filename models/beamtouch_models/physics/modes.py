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
            found[index] = _ringing(seconds[index][:, None], omega, damping_ratio, lasting_s) @ share.T
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


def _ringing(seconds: Floats, omega: Floats, zeta: float, lasting_s: float) -> Floats:
    """Return the motion of oscillators about what they follow, relative to their deflection at rest."""
    damped = math.sqrt(1 - zeta * zeta)
    pole, part = complex(-zeta, damped) * omega, complex(-1.0, zeta / damped)
    since = np.maximum(seconds, 0.0)
    if lasting_s == 0:
        swing: Floats = np.where(seconds >= 0, (part * np.exp(pole * since)).real, 0.0)
        return swing
    before = np.maximum(seconds - lasting_s, 0.0)
    mean: Floats = (part / (pole * lasting_s) * (np.exp(pole * since) - np.exp(pole * before))).real
    return mean


def beyond_rest(target: Floats, step_s: float, omega: Floats, damping_ratio: float) -> Floats:
    """Return how far oscillators that began at rest are from a target that moves, in the target's unit.

    The target (loads, steps, modes) is straight between its steps, which are `step_s` apart; then the result is exact.
    `omega` (modes,) are angular frequencies in 1/s.
    """
    damped = omega * math.sqrt(1 - damping_ratio**2)
    pole = -damping_ratio * omega + 1j * damped
    # The state follows state' = pole state + target; its imaginary part, scaled, is the oscillator.
    grown = np.exp(pole * step_s)
    held = (grown - 1) / pole
    rising = (grown - 1 - pole * step_s) / (pole * pole * step_s)
    state = -target[:, 0] / pole
    found = np.zeros(target.shape)
    for step in range(1, target.shape[1]):
        state = grown * state + target[:, step - 1] * (held - rising) + target[:, step] * rising
        found[:, step] = state.imag * (omega * omega / damped) - target[:, step]
    return found
