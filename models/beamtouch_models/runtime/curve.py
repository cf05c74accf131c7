"""The influence curve of a surface: the deflections at its sensors per newton, for each position of the contact.

`Curve.best_contacts` finds the single contact that explains deflections best: for the health of sensors, calibration,
placement and the challenge. Numpy only, and pure.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime.metadata import Departures, Metadata

STEPS = 3
"""Steps of Gauss and Newton from the best entry of the table; each squares the distance to the best contact."""
FLAT = 1e-9
"""Deflection over the largest one below which an entry of the table counts as a support."""
SINGULAR = 1e-9
"""Smallest part of the precision of a position that does not depend on the force."""
_POWERS = np.arange(4)
_LAGRANGE = np.linalg.inv(np.vander(_POWERS.astype(np.float64), increasing=True))
"""Coefficients of the cubic through four entries of a table, from the entries."""
_SLOPES = _LAGRANGE[1:] * _POWERS[1:, None]
"""The same of its derivative."""
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Curve:
    """A table of the influence, with cubic interpolation."""

    load_mm: Floats
    """(loads,) evenly spaced positions of the contact."""
    influence: Floats
    """(loads, channels) mm/N."""

    def at(self, position_mm: Floats) -> tuple[Floats, Floats]:
        """Return the influence and its slope at positions (contacts,), (contacts, channels) in mm/N and 1/N."""
        step = self.load_mm[1] - self.load_mm[0]
        place = (position_mm - self.load_mm[0]) / step
        first = np.clip(np.floor(place).astype(np.intp) - 1, 0, len(self.load_mm) - 4)
        powers, table = (place - first)[:, None] ** _POWERS, self.influence[first[:, None] + _POWERS]
        value = np.einsum("np,npc->nc", powers @ _LAGRANGE, table)
        return value, np.einsum("np,npc->nc", powers[:, :-1] @ _SLOPES / step, table)

    def best_contacts(
        self, linear_mm: Floats, weight: Floats, known_force_n: float | None = None
    ) -> tuple[Floats, Floats]:
        """Return position [mm] and force [N] (contacts,) that fit deflections best, by weights (contacts, channels).

        If the force is known, the position alone is found.
        """
        square = (self.influence**2).sum(axis=1)
        # On a support, only rounding is left, which would fit anything under a huge force.
        table = np.where(square[:, None] > (FLAT**2) * square.max(), self.influence, 0.0)
        along, square = (linear_mm * weight) @ table.T, np.maximum(weight @ (table**2).T, _TINY)
        if known_force_n is None:
            best = (np.maximum(along, 0.0) ** 2 / square).argmax(axis=1)
            force = np.take_along_axis(along / square, best[:, None], axis=1)[:, 0]
        else:
            best = (2 * along - known_force_n * square).argmax(axis=1)
            force = np.full(len(best), known_force_n)
        position = self.load_mm[best]
        reach = 2 * (self.load_mm[1] - self.load_mm[0])
        low, high = np.maximum(position - reach, self.load_mm[0]), np.minimum(position + reach, self.load_mm[-1])
        shape, slope = self.at(position)
        first = position, force, _explained(weight, force, shape, linear_mm)
        for _ in range(STEPS):
            moved = force[:, None] * slope
            left = linear_mm - force[:, None] * shape
            along_slope, square_slope = _dot(weight, moved, left), _dot(weight, moved, moved)
            if known_force_n is None:
                square_shape, both = _dot(weight, shape, shape), _dot(weight, shape, moved)
                # One channel, or a contact on a support, does not say where the contact is.
                independent = square_shape * square_slope
                determinant = np.maximum(independent - both**2, SINGULAR * independent + _TINY)
                step = (square_shape * along_slope - both * _dot(weight, shape, left)) / determinant
            else:
                step = along_slope / np.maximum(square_slope, _TINY)
            position = np.clip(position + step, low, high)
            shape, slope = self.at(position)
            if known_force_n is None:
                force = _dot(weight, shape, linear_mm) / np.maximum(_dot(weight, shape, shape), _TINY)
        # Beside a support, a step may end on the other side, where only a pull fits.
        is_worse = _explained(weight, force, shape, linear_mm) < first[2]
        return np.where(is_worse, first[0], position), np.where(is_worse, first[1], force)

    def unexplained(self, linear_mm: Floats, weight: Floats) -> Floats:
        """Return the weighted squares that the best contact leaves of deflections, (contacts,); a contact never pulls.

        The arguments are those of `best_contacts`.
        """
        position, force = self.best_contacts(linear_mm, weight)
        left = linear_mm - np.maximum(force, 0.0)[:, None] * self.at(position)[0]
        return _dot(weight, left, left)


@dataclass(frozen=True)
class InfluenceCurve(Curve):
    """The curve of a surface with departures, and what its sensors measure."""

    departures: Departures
    """Those of the surface, whose gains the influence holds; none of a model that is not calibrated."""

    @classmethod
    def of(cls, metadata: Metadata) -> Self:
        """Return the curve of a model."""
        table = np.array(metadata.influence.mm_per_n)
        return cls(np.linspace(*metadata.ranges.position_mm, len(table)), table, metadata.departures)

    def measured_mm(self, position_mm: Floats, force_n: Floats) -> Floats:
        """Return what the sensors measure under contacts (contacts,), (contacts, channels)."""
        return self.departures.measure(force_n[:, None] * self.at(position_mm)[0])

    def moved_mm(self, position_mm: Floats, force_n: Floats) -> Floats:
        """Return how `measured_mm` changes with 1 mm of the position, and with the whole force, relatively.

        The shape is (2, contacts, channels).
        """
        shape, slope = self.at(position_mm)
        bent = self.departures.slope(force_n[:, None] * shape) * force_n[:, None]
        return np.stack([bent * slope, bent * shape])


def _explained(weight: Floats, force_n: Floats, shape: Floats, linear_mm: Floats) -> Floats:
    """Return the weighted squares of deflections that contacts explain, (contacts,); none if they pull."""
    force_n = np.maximum(force_n, 0.0)
    return force_n * (2 * _dot(weight, shape, linear_mm) - force_n * _dot(weight, shape, shape))


def _dot(weight: Floats, one: Floats, other: Floats) -> Floats:
    """Return weighted products over the channels, (contacts,)."""
    product: Floats = np.einsum("nc,nc,nc->n", weight, one, other)
    return product
