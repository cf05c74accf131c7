"""The mean position error of layouts, quickly, and the shares of other loads that they notice.

*Error.* It is the accuracy limit of a few contacts on a coarse grid: the mean width of posteriors, which holds all
errors of a sample: noise, gains, zeros and the mounting of the sensors. If the force is open, the samples themselves
are drawn without errors: of layouts on the bench scene, the ratio of this width to the limit scatters by 0.4 %; with
drawn errors it scatters by 1.2 %, because a layout then fits the errors that were drawn. If it is not, two
places may explain a sample alike, and only drawn errors show how often; then there are more contacts. The contacts are
the same for every layout, and more of them lie where errors are large. The cells of the grid are narrower where an
equal pitch tells more positions apart. Nothing here bounds how much better another layout could be.

*Other loads.* Two kinds of load are not a single contact: two equal contacts half of the range of each axis apart, and
a load distributed evenly over that half, each at several places and with several forces. A load moves the whitened
sample by m. The best single contact leaves the distance

    d^2 = min over x and F >= 0 of |m - F W G(x)|^2 + what a force F beyond the stated range costs,

by which the chi-square of the misfit becomes a noncentral one. The load is noticed if the misfit exceeds the threshold
that a model has at this rate and window. W holds the errors of a settled sample of the load: noise, gains, zeros and
mounting.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import chndtr

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_error_mm
from beamtouch_models.design.accuracy.drawing import concentrate_on_errors, concentrated_ticks, spread_contacts
from beamtouch_models.design.accuracy.likelihood import log_density
from beamtouch_models.design.accuracy.posterior import MIN_LOG
from beamtouch_models.design.accuracy.prior import Prior, forces_of
from beamtouch_models.design.accuracy.thresholds import left_by_contact, misfit_threshold
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.places import Extent, along_axis, grid_of
from beamtouch_models.runtime.curve import Curve
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.force_range import ForceRange

KINDS, PLACES, FORCES = 2, 8, 4
"""Kinds of loads; for each, places over the extent, about, and forces."""
PARTS = 64
"""Point loads that stand for a load distributed over half of the range of each axis."""
CONTACTS = 257
"""Places of the contacts that may explain a load, about."""
CERTAIN = 1e3
"""Largest d^2: such a load is always noticed. The noncentral chi-square takes longer for larger ones."""
SLACK = 0.01
"""Share of other loads that a layout may notice less than a reference: too little to be told from chance in a hundred
loads, and more than a layout that notices none of them could lose."""
SPARE_NOTICES = 0.1
"""Share of the error that noticing all other loads is worth to a layout with a spare."""
CELLS = (256, 1024)
"""Smallest and largest number of cells; between them, one for each mean error of an equal pitch. Twice as many change
no score by more than its scatter."""
KNOWN_FORCE_CONTACTS, OPEN_FORCE_CONTACTS = 512, 128
"""Usual number of contacts; numbers are powers of two."""
LEAST = 64
"""Fewest contacts, and fewest cells."""
AT_ONCE = 64
"""Contacts that are scored at once: their densities stay in the processor's cache."""
NEGLIGIBLE = 15.0
"""Difference to the largest log density beyond which a cell is not part of a posterior."""
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Sampling:
    """The samples by which a model tells loads."""

    errors: Errors
    min_noise_mm: float | None = None
    """Noise of a sample of the most readings; None: that of `errors`."""
    rate_hz: float = 100.0
    """Readings per second."""
    readings: int = 24
    """Readings in the means for which the threshold of misfit holds."""

    @property
    def settled(self) -> Errors:
        """The errors of a sample of the most readings."""
        return self.errors if self.min_noise_mm is None else replace(self.errors, noise_mm=self.min_noise_mm)


@dataclass(frozen=True)
class OtherLoads:
    """Loads that are not one contact, and the contacts that may explain them, at all candidates."""

    sample: Floats
    """(loads, candidates), deflection in mm; for each force, the same number of each kind."""
    precision: Floats
    """(loads, candidates), 1 over the variance of a sample of it, in 1/mm^2."""
    ticks: tuple[Floats, ...]
    """(axes,), coordinates of a grid of contacts."""
    shapes: Floats
    """(contacts, candidates), deflection per newton under them, in mm/N."""
    forces: int
    """Number of forces."""
    stated: ForceRange
    """The range of the force of one contact."""
    sampling: Sampling

    def noticed(self, layout: Indices) -> Floats:
        """Return the share of each kind (kinds,) that a layout (sensors,) notices."""
        free = left_by_contact(len(layout), self.stated.checked)
        square = np.minimum(self.unexplained(layout), CERTAIN)
        missed = chndtr(self.threshold(len(layout)), free, square)
        share: Floats = 1 - missed.reshape(self.forces, KINDS, -1).mean(axis=(0, 2))
        return share

    def threshold(self, sensors: int) -> float:
        """Return the misfit that a model of this many sensors takes for that of one contact at most."""
        sampling, errors = self.sampling, self.sampling.errors
        noise = errors.noise_mm / float(np.hypot(errors.noise_mm, errors.zero_mm))
        return misfit_threshold(noise, sensors, self.stated.checked, sampling.rate_hz, sampling.readings)

    def unexplained(self, layout: Indices) -> Floats:
        """Return d^2 of each load (loads,) for a layout (sensors,)."""
        curve = Curve(self.ticks, self.shapes[:, layout])
        return curve.unexplained(self.sample[:, layout], self.precision[:, layout], self.stated)


def other_loads(influence: InfluenceFunction, rules: LayoutRules, sampling: Sampling) -> OtherLoads:
    """Return the loads on a structure, for sensors at the candidates of these rules."""
    extent, errors = influence.extent, sampling.settled
    half = Extent(tuple((0.0, float(size) / 2) for size in extent.size_mm))
    first = extent.low_mm + half.middles(along_axis(PLACES, extent.axes))[:, None]
    kinds = (first + np.stack([0 * half.size_mm, half.size_mm]), first + half.middles(along_axis(PARTS, extent.axes)))
    weak, strong = influence.force_n
    forces = np.unique(weak + (strong - weak) * (np.arange(FORCES) + 0.5) / FORCES)

    def under(at: Callable[[Floats], Floats]) -> Floats:
        """Return what all loads do, from what 1 N at places (places, axes) does to the candidates."""
        values = [at(kind.reshape(-1, extent.axes)) for kind in kinds]
        means = [value.reshape(len(kinds[0]), -1, *value.shape[1:]).mean(axis=1) for value in values]
        return np.concatenate([force * per_newton for force in forces for per_newton in means])

    sample = under(partial(influence.at, rules.place_mm))
    mounting: Floats | float = 0.0
    if influence.is_uncertain(errors.mounting_mm):
        deviation = under(partial(influence.deviation, rules.place_mm, tolerance_mm=errors.mounting_mm))
        mounting = (deviation**2).sum(axis=2)
    ticks = tuple(extent.ticks(CONTACTS))
    shapes = influence.at(rules.place_mm, grid_of(list(ticks)))
    precision, stated = 1 / errors.variance_mm2(sample, mounting), ForceRange(weak, strong)
    return OtherLoads(sample, precision, ticks, shapes, len(forces), stated, sampling)


@dataclass(frozen=True)
class PositionError:
    """Minus the mean position error of layouts of a structure in mm, on a few contacts: a search makes it largest.

    Without a spare only layouts are allowed that notice other loads as well as `least`. With one, the error is the
    largest over each one sensor failed, less `SPARE_NOTICES` of it times the share of other loads that is noticed.
    """

    rules: LayoutRules
    force_n: tuple[float, float]
    """Range of forces."""
    sampling: Sampling
    spare: int
    """Sensors that may fail, 0 or 1."""
    others: OtherLoads
    least: Floats
    """(kinds,), shares of other loads that a layout without a spare notices at least."""
    edges_mm: list[Floats]
    """(axes,), edges of the cells along each axis of the extent."""
    shapes: Floats
    """(cells, candidates), deflection per newton at the middles of the cells, in mm/N."""
    variance: Floats | None
    """(cells, candidates), its variance by the mounting of a sensor, in (mm/N)^2; None if places are exact."""
    clean_mm: Floats
    """(contacts, candidates), deflection."""
    deviation_mm: Floats
    """(contacts, candidates), standard deviation of a sample of it."""
    noise: Floats
    """(contacts, sensors), with variance 1; 0 if the force is open."""
    weight: Floats
    """(contacts,), 1 on average."""
    at_once: int = 1

    def scores(self, layouts: Indices, above: float = -np.inf) -> Floats:
        """Return minus the error in mm of layouts (population, sensors), ascending; -inf if not allowed.

        With a spare, the score of a layout below `above` is that of the first failed sensor that puts it there.
        """
        scores = np.full(len(layouts), -np.inf)
        for row in np.flatnonzero(self.rules.allowed(layouts)):
            scores[row] = self._score(layouts[row], above)
        return scores

    def _score(self, layout: Indices, above: float) -> float:
        """Return the score of a layout (sensors,) that the rules allow."""
        if not self.spare:
            return -self.error_mm(layout) if np.all(self.others.noticed(layout) >= self.least) else -np.inf
        score, worth = 0.0, self.worth(layout)
        for index in range(len(layout)):
            score = min(score, -worth * self.error_mm(np.delete(layout, index)))
            if score < above:
                break
        return score

    def worth(self, layout: Indices) -> float:
        """Return the factor on the error of a layout (sensors,) for what else it notices; 1 without a spare."""
        return 1 - SPARE_NOTICES * float(self.others.noticed(layout).mean()) if self.spare else 1.0

    def error_mm(self, sensors: Indices) -> float:
        """Return the mean error of sensors (sensors,), ascending, whatever else they notice."""
        parts = range(0, len(self.weight), AT_ONCE)
        distances = [self._distances_mm(sensors, slice(first, first + AT_ONCE)) for first in parts]
        return float(np.concatenate(distances) @ self.weight) / len(self.weight)

    def _distances_mm(self, sensors: Indices, part: slice) -> Floats:
        """Return the mean distances from the posterior medians of a part of the contacts."""
        sample = self.clean_mm[part, sensors] + self.deviation_mm[part, sensors] * self.noise[part, : len(sensors)]
        root = 1 / self.sampling.errors.deviation_mm(sample)
        shapes = self.shapes[None, :, sensors]
        variance = None if self.variance is None else self.variance[None, :, sensors]
        density = log_density(forces_of(self.force_n, 0.0), root, root * sample, shapes, variance, NEGLIGIBLE)
        return mean_distances(self.edges_mm, density)


def position_error_of(
    influence: InfluenceFunction,
    rules: LayoutRules,
    equal: Indices,
    sampling: Sampling,
    seed: int,
    *,
    spare: int = 0,
    reference: Indices | None = None,
    effort: Effort = USUAL,
) -> PositionError:
    """Draw the contacts of the objective.

    `equal` (sensors,) is the allowed layout nearest to equal pitch. A layout without a spare notices other loads as
    well as `reference` (sensors,); None: it need not notice any.
    """
    errors = sampling.errors
    prior = Prior.of(influence, rules.place_mm[equal], errors)
    is_open = prior.force_range.is_open
    usual = OPEN_FORCE_CONTACTS if is_open else KNOWN_FORCE_CONTACTS
    contacts = 1 << (effort.of(usual, LEAST) - 1).bit_length()
    drawn, force, noise = spread_contacts(prior, contacts, np.random.default_rng(seed))
    drawn, weight = concentrate_on_errors(prior, drawn)
    fewest, most = (effort.of(number, LEAST) for number in CELLS)
    cells = float(np.linalg.norm(prior.extent.size_mm)) / cramer_rao_error_mm(prior)
    edges = concentrated_ticks(prior, int(np.clip(cells, fewest, most)))
    middles = grid_of([(ticks[1:] + ticks[:-1]) / 2 for ticks in edges])
    clean = influence.at(rules.place_mm, drawn) * force[:, None]
    variance: Floats | None = None
    mounting: Floats | float = 0.0
    if influence.is_uncertain(errors.mounting_mm):
        variance = influence.variance(rules.place_mm, middles, errors.mounting_mm)
        mounting = influence.variance(rules.place_mm, drawn, errors.mounting_mm) * force[:, None] ** 2
    others = other_loads(influence, rules, sampling)
    return PositionError(
        rules=rules,
        force_n=influence.force_n,
        sampling=sampling,
        spare=spare,
        others=others,
        least=np.array(-np.inf) if reference is None else others.noticed(reference) - SLACK,
        edges_mm=edges,
        shapes=influence.at(rules.place_mm, middles),
        variance=variance,
        clean_mm=clean,
        deviation_mm=errors.deviation_mm(clean, mounting),
        noise=np.zeros_like(noise) if is_open else noise,
        weight=weight / weight.mean(),
    )


def mean_distances(edges_mm: list[Floats], log_density: Floats) -> Floats:
    """Return the mean distance from the median in mm (contacts,) of densities that are constant within each cell.

    Of two axes, the median is that along each, and distances are those of the middles of cells.

    Parameters
    ----------
    edges_mm : (axes,), edges of the cells along each axis
    log_density : (contacts, cells), each row up to a constant
    """
    widths = [np.diff(edges) for edges in edges_mm]
    # In place: fresh memory for each step takes longer than the step.
    mass = log_density - log_density.max(axis=1, keepdims=True)
    np.exp(np.maximum(mass, MIN_LOG, out=mass), out=mass)
    mass *= grid_of(widths).prod(axis=1)
    return _distances_on_line(widths[0], mass) if len(widths) == 1 else _distances_of_cells(edges_mm, mass)


def _distances_of_cells(edges_mm: list[Floats], mass: Floats) -> Floats:
    """Return the mean distances of masses (contacts, cells) from their medians along each axis."""
    mass = mass / mass.sum(axis=1, keepdims=True)
    middles, axes = [(edges[1:] + edges[:-1]) / 2 for edges in edges_mm], range(len(edges_mm))
    masses = mass.reshape(len(mass), *map(len, middles))
    medians = np.empty((len(mass), len(middles)))
    for axis in axes:
        marginal = masses.sum(axis=tuple(1 + other_axis for other_axis in axes if other_axis != axis))
        medians[:, axis] = middles[axis][(np.cumsum(marginal, axis=1) >= 0.5).argmax(axis=1)]
    places = grid_of(middles)
    distances = [row @ np.linalg.norm(places - median, axis=1) for row, median in zip(mass, medians, strict=True)]
    return np.array(distances)


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
