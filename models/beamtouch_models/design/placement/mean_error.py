"""The mean position error of any layout on the same few contacts, quickly.

It is the mean width of posteriors on a grid of cells: for each contact, the distance between the median and what else
could have caused its sample. A log density is a sum over channels of a product of a contact's part and a cell's part,
so two matrix products make those of all contacts and cells.

Samples are drawn without errors, unless noise is asked for: whoever searches among layouts by drawn errors finds the
layout that fits these errors. Without them, the posterior takes twice the variance of a sample. Then it is the mean of
the posteriors of samples with errors, where these are normal: one variance is that of where the errors move it, the
other its own. So it counts places that only errors confuse, which a sample without errors tells apart. Its width is the
root of 2 times that of the others, by which it is divided.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_error_mm
from beamtouch_models.design.accuracy.drawing import concentrate_on_errors, concentrated_ticks, spread_contacts
from beamtouch_models.design.accuracy.posterior import MIN_LOG
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.narrow_posterior import NarrowPosteriors
from beamtouch_models.places import distances_mm, grid_of
from beamtouch_models.runtime.error_model import Errors

AT_ONCE = 64
"""Contacts that are scored at once: their densities stay in the processor's cache."""
NEGLIGIBLE = 10.0
"""Difference to the largest log density beyond which a cell is not part of a posterior."""
FLAT = 1e-6
"""Smallest effect of the range of forces, in deviations of a sample: less, beside a support, is rounding."""
NARROW = 1e-6
"""Length of a range of forces over its end, below which the force is as good as exact, and differences would cancel."""
SPREAD = 2.0
"""Variance of a posterior that is the mean of those of samples with errors, over that of one of them."""
TINY = float(np.finfo(np.float64).tiny)
UNLIKELY = 1e-280
"""Sum of likelihoods below which a posterior is lost: dividing by the sum would overflow."""


@dataclass(frozen=True)
class MeanError:
    """The mean position error of layouts of a structure in mm, on a few contacts."""

    force_n: tuple[float, float]
    """Range of forces, with equal ends if the force is known."""
    edges_mm: list[Floats]
    """(axes,), edges of the cells along each axis of the extent."""
    shapes: Floats
    """(cells, candidates), deflection per newton at the middles of the cells, in mm/N."""
    sample_mm: Floats
    """(contacts, candidates), deflection."""
    precision: Floats
    """(contacts, candidates), 1 over the variance of a sample of it, in 1/mm^2; without errors, over SPREAD, too."""
    place_mm: Floats
    """(contacts, axes)."""
    weight: Floats
    """(contacts,), 1 on average; without errors, over the root of SPREAD."""
    noise: Floats | None = None
    """(contacts, sensors), errors of samples in their deviations; None: samples have no errors."""
    narrow: NarrowPosteriors | None = None
    """On two axes, what resolves posteriors that are narrower than a cell."""

    def of(self, layout: Indices, without: int | None = None) -> float:
        """Return the mean error of a layout (sensors,), ascending, without one of its sensors if asked."""
        return float(self.of_each(layout, without) @ self.weight) / len(self.weight)

    def of_each(self, layout: Indices, without: int | None = None) -> Floats:
        """Return the mean distance of each posterior from its median, (contacts,); arguments as `of`."""
        distances = np.concatenate([mean_distances(self.edges_mm, part) for part in self._likelihoods(layout, without)])
        if self.narrow is None:
            return distances
        narrow = self._narrow_mm(slice(None), layout, without)
        return np.where(narrow < self._cell_mm, narrow, distances)

    @cached_property
    def _cell_mm(self) -> Floats:
        """(contacts,), the smaller side of the cell in which each contact lies."""
        sides = [np.diff(edges)[cell] for edges, cell in zip(self.edges_mm, self._cells, strict=True)]
        smallest: Floats = np.min(sides, axis=0)
        return smallest

    @cached_property
    def _cells(self) -> list[Indices]:
        """(axes,), the number of the cell along each axis in which each contact lies, (contacts,)."""
        return [
            np.clip(np.searchsorted(edges, place, side="right") - 1, 0, len(edges) - 2)
            for edges, place in zip(self.edges_mm, self.place_mm.T, strict=True)
        ]

    def _narrow_mm(self, part: slice, layout: Indices, without: int | None) -> Floats:
        """Return the mean distances (contacts,) of Gaussian posteriors; infinite on one axis."""
        if self.narrow is None:
            return np.full(len(self.weight[part]), np.inf)
        kept = layout if without is None else np.delete(layout, without)
        return self.narrow.distances_mm(part, kept, self.precision[part, kept])

    def along_mm(self, layout: Indices, without: int | None = None) -> Floats:
        """Return the mean error of the contacts in each cell, (cells,); other arguments as `of`.

        Each cell takes its share of each posterior: a sample from one place may as well come from another.
        """
        width, middles, contacts = cell_sizes(self.edges_mm), middles_of(self.edges_mm), len(self.weight)
        sums = np.zeros(len(width))
        for number, likelihood in enumerate(self._likelihoods(layout, without)):
            mass = likelihood * width
            mass *= (self.weight[number * AT_ONCE :][: len(mass)] / mass.sum(axis=1))[:, None]
            if len(self.edges_mm) == 1:
                medians = medians_on_line(self.edges_mm[0], likelihood)[:, None]
            else:
                medians = _medians_of_cells(self.edges_mm, mass)
            apart_mm = distances_mm(middles - medians[:, None])
            if self.narrow is not None:
                self._put_narrow(slice(number * AT_ONCE, number * AT_ONCE + len(mass)), layout, without, mass, apart_mm)
            sums += np.einsum("nc,nc->c", mass, apart_mm)
        mean: Floats = sums / contacts / (width / width.sum())
        return mean

    def _put_narrow(self, part: slice, layout: Indices, without: int | None, mass: Floats, apart_mm: Floats) -> None:
        """Put the posteriors that are narrower than a cell into their cells, with their own mean distances."""
        distance = self._narrow_mm(part, layout, without)
        rows = np.flatnonzero(distance < self._cell_mm[part])
        cell = np.ravel_multi_index([cells[part][rows] for cells in self._cells], [len(e) - 1 for e in self.edges_mm])
        mass[rows], weight = 0.0, self.weight[part][rows]
        mass[rows, cell], apart_mm[rows, cell] = weight, distance[rows]

    def _likelihoods(self, layout: Indices, without: int | None) -> Iterator[Floats]:
        """Yield likelihoods (contacts, cells) of parts of the contacts, up to a factor each."""
        kept = np.arange(len(layout)) if without is None else np.delete(np.arange(len(layout)), without)
        shapes, (low, high) = self.shapes[:, layout[kept]], self.force_n
        for first in range(0, len(self.weight), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            precision, sample = self.precision[part, layout[kept]], self.sample_mm[part, layout[kept]]
            if self.noise is not None:
                sample = sample + self.noise[part][:, kept] / np.sqrt(precision)
            # Squares in units of the deviations: of samples along the shape of a cell, and of shapes per N.
            along, square = (precision * sample) @ shapes.T, precision @ np.square(shapes).T
            is_range = high - low > NARROW * high
            yield _over_forces(along, square, low, high) if is_range else _at_force(along, square, (low + high) / 2)


def _at_force(along: Floats, square: Floats, force_n: float) -> Floats:
    """Return likelihoods (contacts, cells) with a known force; arguments as `_over_forces`, which it overwrites."""
    # In place: fresh memory for each step takes longer than the step.
    square *= force_n**2 / 2
    along *= force_n
    along -= square
    along -= along.max(axis=1, keepdims=True)
    return np.exp(np.maximum(along, MIN_LOG, out=along), out=along)


def _over_forces(along: Floats, square: Floats, low: float, high: float) -> Floats:
    """Return likelihoods (contacts, cells) with an open force integrated out, up to a factor for each contact.

    At a cell it is the integral, over forces F, of exp(-(a - F s)^2 / 2 + a^2 / 2), with a = `along` / s, s^2 =
    `square`. No a^2 exceeds the square of the sample by more than rounding, so that nothing overflows.
    """
    size = np.sqrt(np.maximum(square, (FLAT / (high - low)) ** 2, out=square), out=square)
    along /= size
    exponent = np.square(along) / 2
    exponent -= exponent.max(axis=1, keepdims=True)
    likely = exponent > -NEGLIGIBLE
    size, along = size[likely], along[likely]
    mass = np.zeros(exponent.shape)
    mass[likely] = np.exp(exponent[likely]) * (ndtr(high * size - along) - ndtr(low * size - along)) / size
    # Noise may bring a sample next to no contact of the range; then no cell is likelier than the others.
    mass[mass.sum(axis=1) < UNLIKELY] = 1.0
    return mass


def mean_error_of(
    influence: InfluenceFunction,
    candidate_mm: Floats,
    layout: Indices,
    errors: Errors,
    rng: np.random.Generator,
    *,
    contacts: int,
    cells: tuple[int, int],
    noisy: bool = False,
) -> MeanError:
    """Draw the contacts on which layouts of as many sensors as `layout` (sensors,) are compared.

    Sensors are among candidates (candidates, axes).
    There are more contacts, and narrower cells, where errors of that layout are large. `contacts` is a power of two,
    `cells` the smallest and largest number of cells; between them, one for each mean error of the layout.
    """
    prior = Prior.of(influence, candidate_mm[layout], errors)
    drawn, force, noise = spread_contacts(prior, contacts, rng)
    drawn, weight = concentrate_on_errors(prior, drawn)
    wanted = float(np.linalg.norm(prior.extent.size_mm)) / cramer_rao_error_mm(prior)
    edges = concentrated_ticks(prior, int(np.clip(wanted, *cells)))
    middles = middles_of(edges)
    clean = influence.at(candidate_mm, drawn) * force[:, None]
    is_plate = influence.extent.axes > 1
    mounting: Floats | float = 0.0
    if influence.is_uncertain(errors.mounting_mm):
        mounting = influence.variance(candidate_mm, drawn, errors.mounting_mm) * force[:, None] ** 2
    spread = 1.0 if noisy else SPREAD
    return MeanError(
        force_n=influence.force_n,
        edges_mm=edges,
        shapes=influence.at(candidate_mm, middles),
        place_mm=drawn,
        sample_mm=clean,
        precision=1 / (spread * errors.variance_mm2(clean, mounting)),
        weight=weight / (weight.mean() * float(np.sqrt(spread))),
        noise=noise if noisy else None,
        narrow=NarrowPosteriors.of(influence, candidate_mm, drawn, force) if is_plate else None,
    )


def mean_distances(edges_mm: list[Floats], likelihood: Floats) -> Floats:
    """Return the mean distance from the median in mm (contacts,) of posteriors that are constant within each cell.

    Of two axes, the median is that along each, and distances are those of the middles of cells.

    Parameters
    ----------
    edges_mm : (axes,), edges of the cells along each axis
    likelihood : (contacts, cells), each row up to a factor; it is overwritten
    """
    widths = cell_sizes(edges_mm)
    likelihood *= widths
    return _distances_on_line(widths, likelihood) if len(edges_mm) == 1 else _distances_of_cells(edges_mm, likelihood)


def cell_sizes(edges_mm: list[Floats]) -> Floats:
    """Return the lengths or the areas of cells (cells,) between edges along each axis."""
    widths = [np.diff(edges) for edges in edges_mm]
    sizes: Floats = widths[0] if len(widths) == 1 else grid_of(widths).prod(axis=1)
    return sizes


def middles_of(edges_mm: list[Floats]) -> Floats:
    """Return the middles of cells (cells, axes) between edges along each axis."""
    return grid_of([(edges[1:] + edges[:-1]) / 2 for edges in edges_mm])


def medians_on_line(edges_mm: Floats, likelihood: Floats) -> Floats:
    """Return the medians in mm (contacts,) of such posteriors on one axis; arguments as `mean_distances`."""
    width = np.diff(edges_mm)
    below = np.cumsum(likelihood * width, axis=1)
    below /= below[:, -1:]
    cell, rows = (below >= 0.5).argmax(axis=1), np.arange(len(below))
    before, after = np.where(cell > 0, below[rows, cell - 1], 0.0), below[rows, cell]
    within: Floats = edges_mm[cell] + width[cell] * (0.5 - before) / np.maximum(after - before, TINY)
    return within


def _distances_of_cells(edges_mm: list[Floats], mass: Floats) -> Floats:
    """Return the mean distances of masses (contacts, cells) from their medians along each axis."""
    mass = mass / mass.sum(axis=1, keepdims=True)
    medians = _medians_of_cells(edges_mm, mass)
    along = [edges[1:] + edges[:-1] for edges in edges_mm]
    apart = [middles / 2 - median[:, None] for middles, median in zip(along, medians.T, strict=True)]
    distances: Floats = np.einsum("nij,nij->n", mass.reshape(len(mass), *map(len, along)), _lengths(*apart))
    return distances


def _lengths(along_x: Floats, along_y: Floats) -> Floats:
    """Return the lengths (contacts, x, y) of vectors with these components, (contacts, x) and (contacts, y)."""
    lengths: Floats = np.hypot(along_x[:, :, None], along_y[:, None, :])
    return lengths


def _medians_of_cells(edges_mm: list[Floats], mass: Floats) -> Floats:
    """Return the medians along each axis (contacts, axes) of masses (contacts, cells), the middles of cells."""
    middles, axes = [(edges[1:] + edges[:-1]) / 2 for edges in edges_mm], range(len(edges_mm))
    masses = mass.reshape(len(mass), *map(len, middles))
    medians = np.empty((len(mass), len(middles)))
    for axis in axes:
        marginal = masses.sum(axis=tuple(1 + other_axis for other_axis in axes if other_axis != axis))
        below = np.cumsum(marginal, axis=1)
        medians[:, axis] = middles[axis][(below >= below[:, -1:] / 2).argmax(axis=1)]
    return medians


def _distances_on_line(width: Floats, mass: Floats) -> Floats:
    """Return the same of one axis, from the widths (cells,) and the masses (contacts, cells), which it overwrites."""
    below = np.cumsum(mass, axis=1, out=mass)
    below /= below[:, -1:]
    median = (below >= 0.5).argmax(axis=1)
    rows = np.arange(len(below))
    before, after = np.where(median > 0, below[rows, median - 1], 0.0), below[rows, median]
    # The mean distance is the integral of the smaller of the distribution function and its complement.
    ends = np.minimum(below, 1 - below, out=below)
    trapezoids: Floats = ends @ (width + np.append(width[1:], 0.0)) / 2
    missing = (0.5 - before) * (after - 0.5) / np.maximum(after - before, TINY)
    distances: Floats = trapezoids + width[median] * missing
    return distances
