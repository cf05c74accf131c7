"""The position error of layouts as a customer meets it, and the shares of other loads that they notice.

*Error.* For a share w of the time one sensor has failed, and it may be the one that is missed most:

    (1 - w) e(all) + w max over i of e(all but i),

with the mean position errors e of `mean_error`. With w = 0 it is the error with all sensors, and with w = 1 that with
the worst one failed. Nothing here bounds how much better another layout could be.

*Other loads.* Two kinds of load are not a single contact: two equal contacts half of the range of each axis apart, and
a load distributed evenly over that half, each at several places and with several forces. A load moves the whitened
sample by m. The best single contact leaves the distance

    d^2 = min over x and F >= 0 of |m - F W G(x)|^2 + what a force F beyond the stated range costs,

by which the chi-square of the misfit becomes a noncentral one. The load is noticed if the misfit exceeds the threshold
that a model has at this rate and window. W holds the errors of a settled sample of the load: noise, gains, zeros and
mounting.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.special import chndtr

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.accuracy.thresholds import left_by_contact, misfit_threshold
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.placement.mean_error import MeanError
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
        means = [value.reshape(len(first), -1, *value.shape[1:]).mean(axis=1) for value in values]
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
    """Minus the position error of layouts of a structure in mm, as a customer meets it: a search makes it largest.

    The mean error, and that with the worst sensor failed, count by the shares of the time in which the surface works
    with all sensors and with one failed. A layout that notices other loads less than `least` has no score, or, while
    a search looks for where to begin, a smaller one.
    """

    rules: LayoutRules
    with_all: MeanError
    with_failed: MeanError
    """May have fewer contacts, as errors with a sensor failed count less."""
    failed_share: float
    """Share of the time, 0 to 1, in which the worst sensor has failed."""
    others: OtherLoads
    least: Floats
    """(kinds,), shares of other loads that a layout notices at least."""
    price: float = np.inf
    """Share of the error that noticing none of the other loads, instead of `least`, adds; infinite: it has no score."""
    at_once: int = 1
    missed_most: list[int] = field(default_factory=list)
    """The sensor whose failure was worst last: it is likely the worst again, and tried first. It changes no score."""

    def scores(self, layouts: Indices, above: float = -np.inf) -> Floats:
        """Return minus the error in mm of layouts (population, sensors), ascending; -inf if not allowed.

        The score of a layout below `above` is the first that puts it there.
        """
        scores = np.full(len(layouts), -np.inf)
        for row in np.flatnonzero(self.rules.allowed(layouts)):
            scores[row] = self._score(layouts[row], above)
        return scores

    def error_mm(self, layout: Indices) -> float:
        """Return the error of a layout (sensors,), ascending, whatever else it notices."""
        return -list(self._bounds(layout))[-1]

    def _score(self, layout: Indices, above: float) -> float:
        """Return the score of a layout (sensors,) that the rules allow; the cheap parts come first."""
        for score in self._bounds(layout):
            if score <= above:
                return score
        missing = np.maximum(self.least - self.others.noticed(layout), 0.0).sum()
        return score * (1 + self.price * float(missing)) if missing else score

    def _bounds(self, layout: Indices) -> Iterator[float]:
        """Yield what the score of a layout without regard to other loads is at most, the score itself at last."""
        working, worst = (1 - self.failed_share), 0.0
        error = self.with_all.of(layout) if working else 0.0
        yield -error  # fewer sensors do not err less
        if not self.failed_share or len(layout) == 1:
            return
        order = sorted(range(len(layout)), key=lambda index: index not in self.missed_most)
        for index in order:
            failed = self.with_failed.of(layout, index)
            if failed > worst:
                worst, self.missed_most[:] = failed, [index]
            yield -(working * error + self.failed_share * worst)
