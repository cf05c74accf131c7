"""A model beside the accuracy limit: errors, intervals, detection, each with its standard error. Pure; no I/O."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamtouch_models import cramer_rao, limit
from beamtouch_models.measured import rest_exceeding
from beamtouch_models.modelfile import Answers, ModelFile
from beamtouch_models.prior import Prior

Array = NDArray[np.float64]

MIDDLE = (0.2, 0.8)
"""The part of the length that counts as its middle."""
BLOCKS = 20
"""Parts of the draws whose quantiles scatter: the standard error of a quantile."""


@dataclass(frozen=True)
class Figure:
    """A measured value and its standard error."""

    value: float
    standard_error: float

    def scaled(self, factor: float) -> "Figure":
        """Return the same in another unit."""
        return Figure(self.value * factor, self.standard_error * factor)


@dataclass(frozen=True)
class Errors:
    """|position error| over contacts of a stretch of the beam, in mm."""

    mean_mm: Figure
    p95_mm: Figure
    worst_mm: float
    limit_mean_mm: Figure | None
    """None where the noise is 0, in which there is no limit."""
    limit_p95_mm: Figure | None
    ratio: Figure | None
    """Mean over mean of the limit, on the same contacts."""


@dataclass(frozen=True)
class Evaluation:
    """All that is measured of a model at one noise."""

    noise_mm: float
    draws: int
    length_mm: float
    span: Errors
    """Over the whole range of contacts."""
    middle: Errors | None
    """Over the middle of the length; None where no contact of the range lies there."""
    cramer_rao_mean_mm: float | None
    position_coverage: Figure | None
    """Share of contacts that lie in their stated interval; None where the model states none."""
    position_width_mm: Figure | None
    force_coverage: Figure | None
    force_error_n: Figure | None
    missed: Figure | None
    """Share of contacts that the model does not call one."""
    false_alarms: Figure | None
    """Share of samples at rest that it calls a contact."""


def evaluate(
    model: ModelFile, prior: Prior, *, draws: int, seed: int, progress: Callable[[float], None] = lambda _done: None
) -> Evaluation:
    """Measure a model on simulated contacts of a prior, whose noise may be another than the model was made for."""
    drawn = limit.draw(prior, draws, seed)
    answers = _answers(model, prior.stated(drawn.deflection_mm))
    progress(0.1)
    error = np.abs(answers["position_mm"] - drawn.position_mm)
    best = None
    if prior.noise_mm > 0:
        parts = np.array_split(drawn.deflection_mm, BLOCKS)
        medians = []
        for number, part in enumerate(parts):
            medians.append(limit.posterior_median_mm(prior, part))
            progress(0.1 + 0.8 * (number + 1) / BLOCKS)
        best = np.abs(np.concatenate(medians) - drawn.position_mm)
    low, high = (end * prior.length_mm for end in MIDDLE)
    inside = (drawn.position_mm >= low) & (drawn.position_mm <= high)
    return Evaluation(
        noise_mm=prior.noise_mm,
        draws=draws,
        length_mm=prior.length_mm,
        span=_errors(error, best),
        middle=_errors(error[inside], None if best is None else best[inside]) if inside.sum() >= BLOCKS else None,
        cramer_rao_mean_mm=cramer_rao.mean_error_mm(prior) if prior.noise_mm > 0 else None,
        position_coverage=_coverage(answers, "position", "mm", drawn.position_mm),
        position_width_mm=_width(answers),
        force_coverage=None if prior.force_is_known else _coverage(answers, "force", "n", drawn.force_n),
        force_error_n=mean_of(np.abs(answers["force_n"] - drawn.force_n)) if "force_n" in answers else None,
        missed=_share(answers["contact_log_odds"] <= model.metadata.contact_threshold)
        if "contact_log_odds" in answers
        else None,
        false_alarms=_false_alarms(model, prior, seed + 1),
    )


def at_noise(prior: Prior, noise_mm: float) -> Prior:
    """Return the prior of the same surface with another noise per sample."""
    return replace(prior, noise_mm=noise_mm)


def mean_of(values: Array) -> Figure:
    """Mean and its standard error, of independent values."""
    return Figure(float(values.mean()), float(values.std(ddof=1) / len(values) ** 0.5))


def quantile_of(values: Array, level: float) -> Figure:
    """Quantile of independent values, with the standard error that the quantiles of parts of them scatter by."""
    parts = [np.quantile(part, level) for part in np.array_split(values, BLOCKS)]
    return Figure(float(np.quantile(values, level)), float(np.std(parts, ddof=1) / BLOCKS**0.5))


def ratio_of(error: Array, best: Array) -> Figure:
    """Ratio of two means over the same contacts, with the standard error of a ratio of paired values."""
    ratio = error.mean() / best.mean()
    scatter = (error - ratio * best).std(ddof=1) / len(error) ** 0.5
    return Figure(float(ratio), float(scatter / best.mean()))


def _answers(model: ModelFile, deflection_mm: Array) -> dict[str, Array]:
    return {name: values.astype(np.float64) for name, values in estimates(model, deflection_mm).items()}


def estimates(model: ModelFile, deflection_mm: Array) -> Answers:
    """Answers of a model to deflections (samples, channels), all channels valid."""
    reading = deflection_mm.astype(np.float32)
    return model.estimate(reading, np.ones(reading.shape, np.bool_))


def _errors(error: Array, best: Array | None) -> Errors:
    return Errors(
        mean_mm=mean_of(error),
        p95_mm=quantile_of(error, 0.95),
        worst_mm=float(error.max()),
        limit_mean_mm=None if best is None else mean_of(best),
        limit_p95_mm=None if best is None else quantile_of(best, 0.95),
        ratio=None if best is None else ratio_of(error, best),
    )


def _coverage(answers: dict[str, Array], quantity: str, unit: str, truth: Array) -> Figure | None:
    low, high = (answers.get(f"{quantity}_{end}_{unit}") for end in ("low", "high"))
    return None if low is None or high is None else _share((low <= truth) & (truth <= high))


def _width(answers: dict[str, Array]) -> Figure | None:
    if "position_low_mm" not in answers:
        return None
    return mean_of(answers["position_high_mm"] - answers["position_low_mm"])


def _share(happened: NDArray[np.bool_]) -> Figure:
    """Share of cases, with a standard error that is not zero where none or all of them happened."""
    count, cases = int(happened.sum()), len(happened)
    # One case more either way (Agresti & Coull 1998, doi 10.1080/00031305.1998.10480550, has two).
    spread = ((count + 1) * (cases - count + 1)) ** 0.5 / (cases + 2) ** 1.5
    return Figure(count / cases, spread)


def _false_alarms(model: ModelFile, prior: Prior, seed: int) -> Figure | None:
    if "contact_log_odds" not in model.outputs or prior.noise_mm == 0:
        return None
    share, standard_error = rest_exceeding(prior, model.estimate, seed, model.metadata.contact_threshold)
    return Figure(share, standard_error)
