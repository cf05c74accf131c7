"""The mean position error of layouts, quickly: the accuracy limit of a few contacts on a coarse grid.

It is the mean width of posteriors, which holds all errors of a sample: noise, gains, zeros and the mounting of the
sensors. If the force is open, the samples themselves are drawn without errors: of layouts on the bench scene, the ratio
of this width to the limit scatters by 0.4 %; with drawn errors it scatters by 1.2 %, because a layout then fits the
errors that were drawn. If the force is known, two places may explain a sample alike, and only drawn errors show how
often; then there are more contacts.

The contacts are the same for every layout, and more of them lie where errors are large. The cells of the grid are
narrower where an equal pitch tells more positions apart. Nothing here bounds how much better another layout could be.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy import cramer_rao
from beamtouch_models.accuracy.forces import forces_of
from beamtouch_models.accuracy.limit import UNIFORM, spread_contacts, where_it_errs
from beamtouch_models.accuracy.posterior import log_likelihood
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.cells import TINY, mean_distances, with_mounting
from beamtouch_models.placement.layout import Candidates

CELLS = (256, 1024)
"""Smallest and largest number of cells; between them, one for each mean error of an equal pitch. Twice as many change
no score by more than its scatter."""
KNOWN_FORCE_CONTACTS, OPEN_FORCE_CONTACTS = 512, 128
"""Number of contacts, a power of two."""
AT_ONCE = 64
"""Contacts that are scored at once: their densities stay in the processor's cache."""
BOUND_CELLS = 64
"""Smallest number of cells of the Cramer-Rao bound, which only leads to a start."""
NEGLIGIBLE = 15.0
"""Difference to the largest log density beyond which a cell is not part of a posterior."""


@dataclass(frozen=True)
class Surrogate:
    """The mean position errors of layouts of the same beam, on a few contacts."""

    force_n: tuple[float, float]
    """Range of forces, with equal ends if the force is known."""
    rules: Candidates
    errors: SampleErrors
    edges_mm: Floats
    """(cells + 1,) over the range of contacts."""
    shapes: Floats
    """(cells, candidates), deflection per newton at the middles of the cells, in mm/N."""
    uncertain: Floats | None
    """(cells, candidates), its deviation by the mounting of a sensor, in mm/N; None if positions are exact."""
    clean_mm: Floats
    """(contacts, candidates), deflection."""
    deviation_mm: Floats
    """(contacts, candidates), standard deviation of a sample of it."""
    noise: Floats
    """(contacts, sensors), with variance 1, from left to right; 0 if the force is open."""
    weight: Floats
    """(contacts,), 1 on average."""

    def distances_mm(self, sensors: Indices, few: int | None = None) -> Floats:
        """Return the errors of sensors (sensors,) at the first few contacts, by default at all of them: (contacts,).

        Their mean is the mean error; they include the weights of the contacts.
        """
        contacts = len(self.weight) if few is None else few
        starts = range(0, contacts, AT_ONCE)
        return np.concatenate([self._distances_mm(sensors, slice(at, min(at + AT_ONCE, contacts))) for at in starts])

    def _distances_mm(self, sensors: Indices, part: slice) -> Floats:
        """Return the errors of sensors (sensors,) at a part of the contacts."""
        clean_mm = self.clean_mm[part, sensors]
        sample = clean_mm + self.deviation_mm[part, sensors] * self.noise[part, : len(sensors)]
        precision = 1 / (self.errors.noise_mm**2 + self.errors.zero_mm**2 + (self.errors.gain * sample) ** 2)
        shapes = self.shapes[:, sensors]
        square, along = precision @ (shapes**2).T, (precision * sample) @ shapes.T
        others: Floats | float = 0.0
        if self.uncertain is not None:
            # As in the limit: the likeliest force says how much the mounting adds to each channel's variance.
            force = np.clip(along / np.maximum(square, TINY), *self.force_n)
            moved = self.uncertain[:, sensors]
            square, along, others = with_mounting(force**2, shapes, moved**2, sample, precision)
        density = self._log_density(square, along, others)
        return mean_distances(self.edges_mm, density) * self.weight[part]

    def _log_density(self, square: Floats, along: Floats, others: Floats | float) -> Floats:
        """Return log densities (contacts, cells), with the force integrated out; see `posterior.log_likelihood`."""
        low, high = self.force_n
        if low == high:
            known: Floats = low * (along - low / 2 * square) - others / 2
            return known
        size = np.sqrt(square)
        projection = along / np.where(size > 0, size, 1.0)
        fit = (projection**2 - others) / 2
        largest = fit - (projection - np.clip(projection, low * size, high * size)) ** 2 / 2
        # The integral over the force is at most its largest integrand.
        likely = largest >= largest.max(axis=1, keepdims=True) - NEGLIGIBLE
        density = np.full_like(fit, -np.inf)
        density[likely] = log_likelihood(forces_of(self.force_n, 0.0), size[likely], projection[likely], fit[likely])
        return density

    def cramer_rao_mm(self, sums: Floats) -> Floats:
        """Return the mean Cramer-Rao bound on the error (...), limited by the range.

        `sums` (3, some cells, ...) are those of `information`.
        """
        slope, mixed, size = sums
        low, high = self.force_n
        square = (low * low + low * high + high * high) / 3
        information = slope
        if low < high:
            # A slope along the deflection itself cannot be distinguished from a change of the force.
            information = np.maximum(slope - mixed**2 / np.maximum(size, TINY), 0)
        width = np.diff(self.edges_mm)[self._some]
        limit = 12 / (self.edges_mm[-1] - self.edges_mm[0]) ** 2
        bound: Floats = np.tensordot(width / width.sum(), 1 / np.sqrt(information * square + limit), 1)
        return bound

    @property
    def information(self) -> Floats:
        """What each sensor adds to the Cramer-Rao bound, under a middle force; (3, some cells, candidates)."""
        force, errors = sum(self.force_n) / 2, self.errors
        square = errors.noise_mm**2 + errors.zero_mm**2 + (errors.gain * force * self.shapes) ** 2
        if self.uncertain is not None:
            square += (force * self.uncertain) ** 2
        slope = np.gradient(self.shapes, (self.edges_mm[1:] + self.edges_mm[:-1]) / 2, axis=0)
        return (np.stack([slope**2, slope * self.shapes, self.shapes**2]) / square)[:, self._some]

    @property
    def _some(self) -> slice:
        """The cells at which the Cramer-Rao bound is taken."""
        return slice(None, None, max(1, len(self.shapes) // BOUND_CELLS))


def surrogate_of(
    influence: InfluenceFunction, rules: Candidates, equal: Indices, errors: SampleErrors, seed: int
) -> Surrogate:
    """Draw the contacts of a surrogate; `equal` is the allowed layout nearest to equal pitch."""
    prior = Prior.real(influence, rules.position_mm[equal], errors)
    known = prior.force_is_known
    contacts = KNOWN_FORCE_CONTACTS if known else OPEN_FORCE_CONTACTS
    drawn, force, noise = spread_contacts(prior, contacts, np.random.default_rng(seed))
    drawn, weight = where_it_errs(prior, drawn)
    edges = _edges_mm(prior)
    middles = (edges[1:] + edges[:-1]) / 2
    clean = influence.at(rules.position_mm, drawn) * force[:, None]
    square = errors.noise_mm**2 + errors.zero_mm**2 + (errors.gain * clean) ** 2
    uncertain = None
    if errors.mounting_mm:
        uncertain = influence.deviation(rules.position_mm, middles, errors.mounting_mm)
        square += (influence.deviation(rules.position_mm, drawn, errors.mounting_mm) * force[:, None]) ** 2
    return Surrogate(
        influence.force_n,
        rules,
        errors,
        edges,
        influence.at(rules.position_mm, middles),
        uncertain,
        clean,
        np.sqrt(square),
        noise if known else np.zeros_like(noise),
        weight / weight.mean(),
    )


def _edges_mm(prior: Prior) -> Floats:
    """Return the edges of cells, half of them spread evenly and half where the prior tells positions apart."""
    told_apart = 1 / cramer_rao.mean_errors_mm(prior)
    cells = int(np.clip(told_apart.mean() * (prior.position_mm[1] - prior.position_mm[0]), *CELLS))
    often = UNIFORM + (1 - UNIFORM) * told_apart / told_apart.mean()
    along = np.concatenate([[0.0], np.cumsum(often)]) / often.sum()
    edges: Floats = np.interp(np.linspace(0, 1, cells + 1), along, np.linspace(*prior.position_mm, len(along)))
    return edges
