"""Placement by the accuracy limit: a quick surrogate searches, and the limit itself decides between the finalists.

There are two surrogates, both over the ranges of position and force. The first is the mean Cramer-Rao bound over the
load positions, for noise that is small compared to the deflection; it is made of sums over sensors, so that all
exchanges of a sensor are one array operation. The second is the accuracy limit of a few contacts on a coarse grid, with
the same contacts for every layout (common random numbers). Neither bounds how much better another layout could be.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.densities import densities
from beamtouch_models.accuracy.forces import forces_of
from beamtouch_models.accuracy.limit import accuracy_limit, spread_contacts
from beamtouch_models.accuracy.posterior import log_likelihood
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.progress import Fraction

GRID = 257
DRAWS = 256
FINALISTS = 6
FINAL_DRAWS = (1_500, 8_000)
"""Simulated contacts by which all finalists, and then the best three, are compared."""
MAX_EXCHANGES = 200


@dataclass(frozen=True)
class Surrogate:
    """The accuracy limit of a few contacts on a coarse grid, for layouts of the same beam."""

    force_n: tuple[float, float]
    """Range of forces, with equal ends if the force is known."""
    rules: Candidates
    position_mm: Floats
    """(grid,) over the range of contacts."""
    shapes: Floats
    """(grid, candidates), deflection per newton over the noise."""
    clean: Floats
    """(draws, candidates), deflection over the noise."""
    noise: Floats
    """(draws, sensors), with variance 1."""

    def scores(self, layouts: Indices) -> Floats:
        """Return minus the mean |position error| in mm of layouts (population, sensors); -inf if a rule is broken."""
        allowed = self.rules.allowed(layouts)
        pairs = zip(layouts, allowed, strict=True)
        return np.array([-self._mean_error_mm(np.sort(layout)) if kept else -np.inf for layout, kept in pairs])

    def _mean_error_mm(self, layout: Indices) -> float:
        shapes = self.shapes[:, layout]
        size = np.linalg.norm(shapes, axis=1)
        projection = (self.clean[:, layout] + self.noise) @ (shapes / np.where(size > 0, size, 1.0)[:, None]).T
        density = log_likelihood(forces_of(self.force_n, 0.0), size, projection, projection**2 / 2)
        return float(densities(np.broadcast_to(self.position_mm, density.shape), density).mean_distance().mean())

    def cramer_rao_mm(self, sums: Floats) -> Floats:
        """Return the mean Cramer-Rao bound on the error (...), limited by the range, from `sums` (3, grid, ...)."""
        slope, mixed, size = sums
        low, high = self.force_n
        square = (low * low + low * high + high * high) / 3
        information = slope
        if low < high:
            # A slope along the deflection itself cannot be distinguished from a change of the force.
            information = np.maximum(slope - mixed**2 / np.maximum(size, np.finfo(np.float64).tiny), 0)
        span = self.position_mm[-1] - self.position_mm[0]
        bound: Floats = (1 / np.sqrt(information * square + 12 / span**2)).mean(axis=0)
        return bound

    def cramer_rao_layout(self, start: Indices) -> Indices:
        """Return the layout that single exchanges by the Cramer-Rao bound reach from `start`."""
        slope = np.gradient(self.shapes, self.position_mm, axis=0)
        terms = np.stack([slope**2, slope * self.shapes, self.shapes**2])
        layout, value = start, float(self.cramer_rao_mm(terms[:, :, start].sum(axis=2)))
        for _ in range(MAX_EXCHANGES):
            near, fixed = self.rules.conflicts(layout), self.rules.is_fixed(layout)
            trials = []
            for k in np.flatnonzero(~fixed):
                others = np.delete(layout, k)
                values = self.cramer_rao_mm(terms[:, :, others].sum(axis=2)[:, :, None] + terms)
                values[np.delete(near, k, axis=0).any(axis=0)] = np.inf
                trials.append((float(values.min()), int(k), int(values.argmin())))
            best = min(trials, default=(np.inf, 0, 0))
            if not best[0] < value * (1 - 1e-9):
                break
            value, layout = best[0], np.sort(np.append(np.delete(layout, best[1]), best[2]))
        return layout


def surrogate_of(
    influence: InfluenceFunction, rules: Candidates, count: int, errors: SampleErrors, seed: int
) -> Surrogate:
    """Draw the contacts of a surrogate."""
    grid = np.linspace(*influence.position_mm, GRID)
    drawn, force, noise = spread_contacts(
        Prior.real(influence, np.zeros(count), errors), DRAWS, np.random.default_rng(seed)
    )
    return Surrogate(
        influence.force_n,
        rules,
        grid,
        influence.at(rules.position_mm, grid) / errors.noise_mm,
        influence.at(rules.position_mm, drawn) * (force / errors.noise_mm)[:, None],
        noise,
    )


def decided(
    influence: InfluenceFunction,
    rules: Candidates,
    layouts: list[Indices],
    errors: SampleErrors,
    seed: int,
    progress: Fraction,
) -> Indices:
    """Return the layout with the smallest accuracy limit; `layouts` lists the most promising first."""
    distinct = list({tuple(layout): layout for layout in layouts}.values())[:FINALISTS]
    for draws in FINAL_DRAWS:
        limits = []
        for number, layout in enumerate(distinct):
            progress(number / len(distinct))
            limits.append(accuracy_limit(Prior.real(influence, rules.position_mm[layout], errors), draws, seed).percent)
        distinct = [distinct[index] for index in np.argsort(limits, kind="stable")[:3]]
    return distinct[0]
