"""A beam by transfer matrices in as many digits as wanted: what the influence matrix is compared with.

The states (deflection, rotation, moment, shear force, 1) are carried from event to event along the beam by the matrix
exponential, as linear functions of the unknown reactions, and the conditions at supports and ends are solved for them:
another method than ours, in another arithmetic. Pestel & Leckie, Matrix Methods in Elastomechanics, 1963, ch. 3.
"""

from dataclasses import dataclass, field
from typing import Any

import mpmath
import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from beamtouch_models.design.scene.beam import Beam, Support

Number = Any  # mpmath ships no types
Matrix = NDArray[np.object_]
"""Of mpmath's numbers; products are several times as quick as those of its own matrices."""


@dataclass(frozen=True)
class ExactBeam:
    """A beam as its scene states it, computed with so many digits."""

    beam: Beam
    digits: int = 50
    _known: dict[tuple[Number, ...], Matrix] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Matrices from event to event: most come up for many sensors and loads."""

    def deflection(self, x: float, a: float, width: float = 0.0) -> Number:
        """Deflection in mm/N at x under 1 N at a, spread evenly over what of `width` lies on the beam."""
        with mp.workdps(self.digits):
            return self._deflection(mp.mpf(x), mp.mpf(a), mp.mpf(width))

    def _deflection(self, x: Number, a: Number, width: Number) -> Number:
        length, supports = mp.mpf(self.beam.length_mm), self.beam.support_list
        low, high = max(a - width / 2, mp.mpf(0)), min(a + width / 2, length)
        unknowns = 2 + sum(2 if support.kind == "fixed" else 1 for support in supports)
        state = zeros(5, unknowns + 1)
        state[0, 0] = state[1, 1] = state[4, unknowns] = mp.mpf(1)
        conditions, at_sensor, fresh = [], None, 2
        events = {mp.mpf(0), length, x, low, high}
        events |= {mp.mpf(support.at_mm) for support in supports}
        events |= {mp.mpf(section.to_mm) for section in self.beam.sections}
        before = mp.mpf(0)
        for event in sorted(events):
            pressed = high > low and low <= before and event <= high
            state = self._carried(before, event, 1 / (high - low) if pressed else mp.mpf(0)) @ state
            before = event
            if event == low == high:
                state[3, unknowns] -= 1
            for support in supports:
                if mp.mpf(support.at_mm) == event:
                    for row in (0, 1) if support.kind == "fixed" else (0,):
                        conditions.append(state[row].copy())
                        state[3 - row, fresh] += 1
                        fresh += 1
                    state[2] = state[2] + self._stiffness(support) * state[1]
            if event == x:
                at_sensor = state[0].copy()
        assert at_sensor is not None
        system = np.array([*conditions, state[2], state[3]])
        reactions = mpmath.lu_solve(mpmath.matrix(system[:, :-1].tolist()), mpmath.matrix((-system[:, -1]).tolist()))
        return at_sensor[unknowns] + sum(at_sensor[column] * reactions[column] for column in range(unknowns))

    def _stiffness(self, support: Support) -> Number:
        """Rotational stiffness of a support in N mm: fixity is 1 / (1 + 3 E I / (k L)), of the stiffest section."""
        fixity = mp.mpf(support.fixity)
        rigidity = max(mp.mpf(section.rigidity_n_mm2) for section in self.beam.sections)
        return 3 * fixity / (1 - fixity) * rigidity / mp.mpf(self.beam.length_mm)

    def _carried(self, start: Number, end: Number, pressure: Number) -> Matrix:
        if (start, end, pressure) not in self._known:
            self._known[start, end, pressure] = self._exponential(start, end, pressure)
        return self._known[start, end, pressure]

    def _exponential(self, start: Number, end: Number, pressure: Number) -> Matrix:
        section = next(section for section in self.beam.sections if end <= mp.mpf(section.to_mm))
        system = zeros(5, 5)
        system[0, 1] = mp.mpf(1)
        if self.beam.shear_modulus_gpa is not None:
            system[0, 3] = 6 / (5000 * mp.mpf(self.beam.shear_modulus_gpa) * mp.mpf(section.area_mm2))
        system[1, 2] = 1 / mp.mpf(section.rigidity_n_mm2)
        system[2, 3] = mp.mpf(-1)
        system[3, 0] = mp.mpf(self.beam.foundation_n_mm2 or 0.0)
        system[3, 4] = -pressure
        system *= end - start
        total: Matrix = zeros(5, 5) + np.eye(5, dtype=int)
        term = total
        order = 1
        while np.abs(term).max() > mp.eps * np.abs(total).max():
            term = term @ system / order
            total = total + term
            order += 1
        return total


def zeros(rows: int, columns: int) -> Matrix:
    """A matrix of exact zeros."""
    return np.full((rows, columns), mp.mpf(0), dtype=object)


def simple(*at_mm: float) -> list[dict[str, object]]:
    """Simple supports, as a scene states them."""
    return [{"at_mm": place, "kind": "simple"} for place in at_mm]


def fixed(*at_mm: float) -> list[dict[str, object]]:
    """Fixed supports, as a scene states them."""
    return [{"at_mm": place, "kind": "fixed"} for place in at_mm]
