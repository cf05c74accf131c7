"""Evaluation of a model: errors beside the accuracy limit, intervals, detection, with standard errors. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from beamtouch_common.digits import Rounded
from beamtouch_common.outline import names_of
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_error_mm
from beamtouch_models.design.accuracy.limit import simulated
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import (
    SCRAMBLINGS,
    Measurement,
    mean_of,
    quantile_of,
    ratio_of,
    share_of,
)
from beamtouch_models.design.accuracy.thresholds import smallest_forces
from beamtouch_models.design.sweeps import Fraction, TaskMap, in_turn, silent
from beamtouch_models.places import distances_mm
from beamtouch_models.runtime.description import extremes
from beamtouch_models.runtime.loading import ModelFile
from beamtouch_models.runtime.session import stated_mm

MIDDLE = (0.2, 0.8)
"""Bounds of the middle of the beam, over its length."""


@dataclass(frozen=True, repr=False)
class PositionErrors(Rounded):
    """|position error| over contacts of a stretch of the beam, in mm.

    >>> errors = model.evaluate(draws=200).middle
    >>> print(errors.mean_mm, "mm, where no estimator can have less than", errors.limit_mean_mm)
    1.81 +- 0.05 mm, where no estimator can have less than 1.81 +- 0.05
    """

    mean_mm: Measurement
    p95_mm: Measurement
    worst_mm: float
    """Largest error of the drawn contacts; it grows with the number of draws."""
    limit_mean_mm: Measurement | None
    """None if the noise is 0, so that there is no limit."""
    limit_p95_mm: Measurement | None
    ratio: Measurement | None
    """Mean error over the mean of the limit, on the same contacts."""


@dataclass(frozen=True, repr=False)
class Evaluation(Rounded):
    """The evaluation of a model at one noise.

    >>> found = model.evaluate(draws=200)
    >>> print(found.span.mean_mm, "mm; over the limit:", round(found.span.ratio.value, 2))
    2.9 +- 0.06 mm; over the limit: 1.0
    >>> print(f"{found.position_coverage.value:.0%} of contacts lie in their intervals")
    96% of contacts lie in their intervals
    """

    noise_mm: float
    draws: int
    length_mm: float
    span: PositionErrors
    """Over the whole range of contacts."""
    middle: PositionErrors | None
    """Over the middle of the beam; None if too few contacts lie there."""
    cramer_rao_mean_mm: float | None
    position_coverage: Measurement | None
    """Share of contacts inside their interval, the mean of both axes on a plate; None if the model gives no interval.
    """
    position_width_mm: Measurement | None
    """Length of the interval, likewise."""
    force_coverage: Measurement | None
    force_error_n: Measurement | None
    missed: Measurement | None
    """Share of contacts that are not detected."""
    smallest_force_n: tuple[float | None, float | None] | None
    """Smallest force of which 95 % of settled samples are a contact: where it is least, and where it is largest; None:
    nothing is seen there."""
    unexplained: Measurement | None
    """Share of contacts whose misfit exceeds its threshold; None for a model that states none."""
    axis_coverage: dict[str, Measurement] | None = None
    """On a plate, `position_coverage` of each axis."""


def evaluate(
    model: ModelFile,
    prior: Prior,
    *,
    draws: int,
    seed: int,
    missing: Sequence[int] = (),
    progress: Fraction = silent,
    spread: TaskMap = in_turn,
) -> Evaluation:
    """Measure a model on at least `draws` simulated contacts of a prior, at the noise of the prior.

    `missing` are the places of channels that take no part; the limit is that of the others.
    """
    prior = prior.without(*missing) if missing else prior
    contacts = simulated(prior, draws, seed, lambda done: progress(0.8 * done), spread)
    drawn, likely, counts, axes = contacts.drawn, contacts.likely_mm, contacts.drawn.weight, prior.axes
    weight = np.broadcast_to(counts[:, None], likely.shape[:2])
    answers, thresholds = estimates(model, prior, drawn.deflection_mm, missing), model.metadata.thresholds
    place, estimate_mm = prior.channels - 1, stated_mm(answers, axes)
    progress(0.9)
    worst = distances_mm(estimate_mm - drawn.place_mm)
    error = contacts.error_mm(estimate_mm)
    best = contacts.least_error_mm() if prior.errors.noise_mm else None
    low, high = (end * np.array(model.metadata.size_mm) for end in MIDDLE)
    inside, drawn_inside = (((low <= places) & (places <= high)).all(axis=-1) for places in (likely, drawn.place_mm))
    span = _errors(error, best, weight, worst)
    if prior.errors.noise_mm:  # means over each posterior scatter less
        reached = contacts.reached(estimate_mm)
        span = replace(span, mean_mm=reached.error_mm, limit_mean_mm=reached.limit_mm, ratio=reached.ratio)
    has_middle = drawn_inside.any() and all(part.any() for part in np.array_split(inside, SCRAMBLINGS))
    tells_contact, has_interval = "contact_log_odds" in answers, names_of(axes[0], "mm")[1] in answers
    tells_force, smallest_n = "force_n" in answers, None
    if tells_contact and prior.errors.noise_mm > 0:
        supports_mm = [support.at_mm for support in model.metadata.drawn.supports]
        smallest_n = extremes(smallest_forces(prior, thresholds.touch[place], supports_mm).force_n)
    coverage, coverage_of_all, width_mm = None, None, None
    if has_interval:
        low_mm, high_mm = (stated_mm(answers, axes, end) for end in (1, 2))
        held = contacts.held(low_mm, high_mm)
        coverage = {axis: share_of(held[..., number], weight) for number, axis in enumerate(axes)}
        coverage_of_all = share_of(held, np.broadcast_to(weight[..., None], held.shape))
        width_mm = mean_of((high_mm - low_mm).mean(axis=1), counts)
    return Evaluation(
        noise_mm=prior.errors.noise_mm,
        draws=len(worst),
        length_mm=prior.diagonal_mm,
        span=span,
        middle=_errors(error, best, weight * inside, worst[drawn_inside]) if has_middle else None,
        cramer_rao_mean_mm=cramer_rao_error_mm(prior) if prior.errors.noise_mm > 0 else None,
        position_coverage=coverage_of_all,
        position_width_mm=width_mm,
        force_coverage=share_of(
            (answers["force_low_n"] <= drawn.force_n) & (drawn.force_n <= answers["force_high_n"]), counts
        )
        if tells_force and prior.force_n[0] < prior.force_n[1]
        else None,
        force_error_n=mean_of(np.abs(answers["force_n"] - drawn.force_n), counts) if tells_force else None,
        missed=share_of(answers["contact_log_odds"] <= thresholds.touch[place], counts) if tells_contact else None,
        smallest_force_n=smallest_n,
        unexplained=share_of(answers["misfit"] > thresholds.misfit[place], counts) if "misfit" in answers else None,
        axis_coverage=coverage if len(axes) > 1 else None,
    )


def estimates(model: ModelFile, prior: Prior, deflection_mm: Floats, missing: Sequence[int] = ()) -> dict[str, Floats]:
    """Return the answers to deflections (samples, channels) that are linear in the force.

    The channels are those of the prior: all of the model but those at the places `missing`.
    """
    linear = np.zeros((len(deflection_mm), len(model.channels)))
    linear[:, np.setdiff1d(np.arange(len(model.channels)), missing)] = deflection_mm
    measured = prior.measured(linear)
    measured[:, list(missing)] = np.nan
    return model.answer(measured, prior.errors.noise_mm)


def _errors(error: Floats, best: Floats | None, weight: Floats, worst: Floats) -> PositionErrors:
    return PositionErrors(
        mean_mm=mean_of(error, weight),
        p95_mm=quantile_of(error, 0.95, weight),
        worst_mm=float(worst.max()),
        limit_mean_mm=None if best is None else mean_of(best, weight),
        limit_p95_mm=None if best is None else quantile_of(best, 0.95, weight),
        ratio=None if best is None else ratio_of(error * weight, best * weight),
    )
