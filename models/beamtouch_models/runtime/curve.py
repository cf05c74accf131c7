"""The influence of a surface: what its sensors show per newton, for each place of the contact.

`Curve.best_contacts` finds the single contact that explains deflections best: for the health of sensors,
calibration, placement and the challenge. Numpy only, and pure.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.places import grid_of
from beamtouch_models.runtime.departures import Departures
from beamtouch_models.runtime.force_range import ANY_FORCE, ForceRange
from beamtouch_models.runtime.metadata import Metadata

STEPS = 3
"""Steps of Gauss and Newton from the best node of the table; each squares the distance to the best contact."""
FLAT = 1e-9
"""Deflection over the largest one below which a node of the table counts as a support."""
SINGULAR = 1e-9
"""Smallest part of the precision of a place that does not depend on the force."""
_POWERS = np.arange(4)
_LAGRANGE = np.linalg.inv(np.vander(_POWERS.astype(np.float64), increasing=True))
"""Coefficients of the cubic through four entries of a table, from the entries."""
_SLOPES = _LAGRANGE[1:] * _POWERS[1:, None]
"""The same of its derivative."""
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Curve:
    """A table of the influence, with cubic interpolation along each axis."""

    ticks: tuple[Floats, ...]
    """(axes,), evenly spaced coordinates of the nodes along each axis, four at least."""
    influence: Floats
    """(nodes, channels) mm/N, at the places of `places.grid_of` the ticks."""

    @cached_property
    def place_mm(self) -> Floats:
        """The nodes, (nodes, axes)."""
        return grid_of(list(self.ticks))

    def at(self, place_mm: Floats) -> tuple[Floats, Floats]:
        """Return the influence (contacts, channels) in mm/N and its slopes (contacts, channels, axes) in 1/N at places.

        Places are (contacts, axes).
        """
        rows = np.zeros((len(place_mm), 1), dtype=np.intp)
        weights = []
        for axis, ticks in enumerate(self.ticks):
            step = ticks[1] - ticks[0]
            along = (place_mm[:, axis] - ticks[0]) / step
            first = np.clip(np.floor(along).astype(np.intp) - 1, 0, len(ticks) - 4)
            powers = (along - first)[:, None] ** _POWERS
            weights.append((powers @ _LAGRANGE, powers[:, :-1] @ _SLOPES / step))
            rows = (rows[:, :, None] * len(ticks) + (first[:, None] + _POWERS)[:, None, :]).reshape(len(rows), -1)
        table = self.influence[rows]

        def along_axes(sloped: int | None) -> Floats:
            """Return the values, or their slope along an axis."""
            values = table
            for axis, pair in enumerate(weights):
                parts = values.reshape(len(values), 4, -1, table.shape[2])
                values = np.einsum("np,npkc->nkc", pair[axis == sloped], parts)
            return values[:, 0]

        return along_axes(None), np.stack([along_axes(axis) for axis in range(len(weights))], axis=-1)

    def best_contacts(self, linear_mm: Floats, weight: Floats, stated: ForceRange = ANY_FORCE) -> tuple[Floats, Floats]:
        """Return the contacts that fit deflections best, by weights (contacts, channels).

        `stated` is the range of their forces: those beyond it fit less well.

        Returns
        -------
        places (contacts, axes) in mm, and forces (contacts,) in N
        """
        square = (self.influence**2).sum(axis=1)
        # On a support, only rounding is left, which would fit anything under a huge force.
        table = np.where(square[:, None] > (FLAT**2) * square.max(), self.influence, 0.0)
        along, square = (linear_mm * weight) @ table.T, np.maximum(weight @ (table**2).T, _TINY)
        forces = stated.likeliest(along / square, square)
        # What contacts explain; none if they would have to pull.
        explained = np.maximum(forces, 0.0) * (2 * along - forces * square) - stated.misfit(forces)
        best = explained.argmax(axis=1)
        place, force = self.place_mm[best], np.take_along_axis(forces, best[:, None], axis=1)[:, 0]
        reach = 2 * np.array([ticks[1] - ticks[0] for ticks in self.ticks])
        ends = (np.array([ticks[end] for ticks in self.ticks]) for end in (0, -1))
        low, high = np.maximum(place - reach, next(ends)), np.minimum(place + reach, next(ends))
        shape, slope = self.at(place)
        first = place, force, _explained(weight, force, shape, linear_mm) - stated.misfit(force)
        for _ in range(STEPS):
            square = np.maximum(_dot(weight, shape, shape), _TINY)
            # Beyond the stated range, the nearest end of it is one more channel, which reads the force.
            beyond = stated.beyond(_dot(weight, shape, linear_mm) / square)
            weights = np.column_stack([weight, stated.penalty_per_n2 * (beyond != 0)])
            left = np.column_stack([linear_mm - force[:, None] * shape, -stated.beyond(force)])
            shapes = np.column_stack([shape, np.ones(len(shape))])
            moved = np.pad(force[:, None, None] * slope, ((0, 0), (0, 1), (0, 0)))
            # A change along the shape may as well come from the force.
            square = np.maximum(_dot(weights, shapes, shapes), _TINY)
            along_shape = np.einsum("nc,nca,nc->na", weights, moved, shapes) / square[:, None]
            across = moved - shapes[:, :, None] * along_shape[:, None]
            place = np.clip(place + _step(weights, moved, across, left), low, high)
            shape, slope = self.at(place)
            square = np.maximum(_dot(weight, shape, shape), _TINY)
            force = stated.likeliest(_dot(weight, shape, linear_mm) / square, square)
        # Beside a support, a step may end on the other side, where only a pull fits.
        is_worse = _explained(weight, force, shape, linear_mm) - stated.misfit(force) < first[2]
        return np.where(is_worse[:, None], first[0], place), np.where(is_worse, first[1], force)

    def unexplained(self, linear_mm: Floats, weight: Floats, stated: ForceRange = ANY_FORCE) -> Floats:
        """Return the weighted squares that rest or the best contact leaves of deflections, (contacts,).

        A contact never pulls, and one whose force is beyond the stated range leaves more. The arguments are those of
        `best_contacts`.
        """
        place, force = self.best_contacts(linear_mm, weight, stated)
        force = np.maximum(force, 0.0)
        residual_mm = linear_mm - force[:, None] * self.at(place)[0]
        left = _dot(weight, residual_mm, residual_mm) + stated.misfit(force)
        return np.minimum(left, _dot(weight, linear_mm, linear_mm))


@dataclass(frozen=True)
class InfluenceCurve(Curve):
    """The influence of a surface with departures, and what its sensors measure."""

    departures: Departures
    """Those of the surface, whose gains the influence holds; none of a model that is not calibrated."""

    @classmethod
    def of(cls, metadata: Metadata) -> Self:
        """Return the influence of a model."""
        table = np.array(metadata.influence.mm_per_n)
        return cls(tuple(metadata.extent.ticks(len(table))), table, metadata.departures)

    def measured_mm(self, place_mm: Floats, force_n: Floats) -> Floats:
        """Return what the sensors measure under contacts at places (contacts, axes), (contacts, channels)."""
        return self.departures.measure(force_n[:, None] * self.at(place_mm)[0])

    def moved_mm(self, place_mm: Floats, force_n: Floats) -> Floats:
        """Return how `measured_mm` changes with 1 mm along each axis, and with the whole force, relatively.

        The shape is (axes + 1, contacts, channels).
        """
        shape, slope = self.at(place_mm)
        bent = self.departures.slope(force_n[:, None] * shape) * force_n[:, None]
        return np.stack([*np.moveaxis(bent[:, :, None] * slope, 2, 0), bent * shape])


def _step(weight: Floats, moved: Floats, across: Floats, left: Floats) -> Floats:
    """Return the step of the place (contacts, axes) that takes most of the residuals `left` (contacts, channels).

    `moved` (contacts, channels, axes) is how the deflections move along each axis, `across` the part of it that a force
    does not explain. One channel, or a contact on a support, does not say where the contact is.
    """
    weighed = weight[:, :, None] * across
    precision = np.einsum("nca,ncb->nab", weighed, across)
    own = np.einsum("nc,nca,nca->na", weight, moved, moved)
    # With fewer channels than axes this would be singular; less beside the diagonal keeps the step finite.
    axes = np.arange(moved.shape[2])
    alone = np.maximum(precision[:, axes, axes], SINGULAR * own + _TINY)
    precision *= 1 - SINGULAR
    precision[:, axes, axes] = alone
    return np.linalg.solve(precision, np.einsum("nca,nc->na", weighed, left)[..., None])[..., 0]


def _explained(weight: Floats, force_n: Floats, shape: Floats, linear_mm: Floats) -> Floats:
    """Return the weighted squares of deflections that contacts explain, (contacts,); none if they pull."""
    force_n = np.maximum(force_n, 0.0)
    return force_n * (2 * _dot(weight, shape, linear_mm) - force_n * _dot(weight, shape, shape))


def _dot(weight: Floats, one: Floats, other: Floats) -> Floats:
    """Return weighted products over the channels, (contacts,)."""
    product: Floats = np.einsum("nc,nc,nc->n", weight, one, other)
    return product
