"""Measurements on a finished estimator: its error beside the accuracy limit, and the fields of its metadata.

These are accuracy, thresholds, smallest force and golden answers. A posterior is refused if its error or its coverage
misses the limit.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.limit import Reached, limits_with_one_failed, simulate_until_certain
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import Measurement, share_of
from beamtouch_models.design.accuracy.thresholds import (
    PLACES,
    readings_alike,
    smallest_forces,
    touch_thresholds,
    unexplained_thresholds,
)
from beamtouch_models.design.building.since_touch import answers_of_means, answers_since_touch
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.estimators.estimator import Estimator
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.placement.placing import Aim
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.surface import Surface
from beamtouch_models.design.world import World
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.runtime.metadata_parts import (
    Accuracy,
    Floor,
    Golden,
    Influence,
    LayoutErrors,
    SinceTouch,
    SmallestForce,
    Thresholds,
)
from beamtouch_models.runtime.session import Run, runner, stated_mm

ACCURACY_DRAWS, LEAST_DRAWS = 4_096, 256
"""Usual and smallest number of simulated contacts."""
GOLDEN_DRAWS = 6
DIGITS = 7
"""Significant digits in the table of influence."""
MAX_RATIO, MIN_COVERAGE = 1.2, 0.9
"""Largest mean error over the limit, and smallest share of positions inside their 95 % intervals."""
SURE = 4.0
"""Number of standard errors by which a bound must be missed."""


@dataclass(frozen=True)
class Measured:
    """Fields of the metadata that are measured, by their names there."""

    min_channels: int
    thresholds: Thresholds
    smallest_force: SmallestForce
    floor: Floor
    influence: Influence
    accuracy: Accuracy
    placed: LayoutErrors
    golden: Golden


def measure(estimator: Estimator, prior: Prior, surface: Surface, world: World, seed: int, aim: Aim) -> Measured:
    """Measure an estimator on simulated samples of its prior, using the seeds `seed` + 2 and `seed` + 3.

    `surface` is that of the model, `world` its simulation, `aim` that of its layout, with the effort. Errors are those
    of `reach`.
    """
    run = runner(to_bytes(estimator.graph))
    try:
        draws = aim.effort.of(ACCURACY_DRAWS, LEAST_DRAWS)
        reached = reach(estimator, prior, run, draws, seed + 2, surface.scene)
    except NotGoodEnoughError as error:
        raise NotGoodEnoughError(f"nothing was written: {error}") from None
    thresholds = thresholds_of(prior, surface)
    accuracy = _accuracy(prior, run, reached, surface, world, seed + 2, aim.effort)
    with_all = Measurement(accuracy.limit_percent, accuracy.limit_standard_error)
    failed = limits_with_one_failed(prior, with_all, seed, aim.effort)
    # Cubic interpolation of this table is off by at most 6e-4 of the largest influence of any shipped scene, at the
    # kink that shear makes, and by 3e-5 elsewhere.
    table = prior.influence_at(prior.extent.grid(PLACES))
    gain, zero_mm = (values.tolist() for values in prior.errors.of_channels(prior.channels))
    return Measured(
        min_channels=estimator.min_channels,
        thresholds=thresholds,
        smallest_force=smallest_forces(prior, thresholds.touch[-1], surface.held_mm),
        floor=Floor(gain=gain, zero_mm=zero_mm, drift_mm_per_min=surface.readings.drift_mm_per_min),
        influence=Influence(mm_per_n=[[float(f"{value:.{DIGITS}g}") for value in row] for row in table]),
        accuracy=accuracy,
        placed=LayoutErrors(
            criterion=aim.criterion,
            failed_percent=aim.failed_percent,
            limit_without_percent=[without.value for without in failed],
            limit_without_standard_error=[without.standard_error for without in failed],
        ),
        golden=_golden(prior, run, seed + 3),
    )


def thresholds_of(prior: Prior, surface: Surface) -> Thresholds:
    """Return the thresholds: touch for the scene's false contacts per day, rest and misfit for fixed rates."""
    rest, misfit = unexplained_thresholds(prior, surface.scene.sensors.rate_hz, readings_alike(surface.filter))
    return Thresholds(
        touch=touch_thresholds(prior, surface.touch_rate),
        rest=rest,
        misfit=misfit,
        false_contacts_per_day=surface.scene.requirements.false_contacts_per_day,
    )


def reach(made: Estimator, prior: Prior, run: Run, draws: int, seed: int, scene: Scene) -> Reached:
    """Measure an estimator, whose graph `run` runs, beside the accuracy limit on simulated contacts.

    Raises
    ------
    NotGoodEnoughError
        An answer is not finite, or the error or the coverage of a posterior misses its bound beyond chance.
    """
    contacts = simulate_until_certain(prior, draws, seed)
    deflection = prior.measured(contacts.drawn.deflection_mm)
    answers = run(deflection, prior.errors.whitening(deflection))
    if not all(np.isfinite(values).all() for values in answers.values()):
        raise NotGoodEnoughError("some answers of the model are not finite; check the scene for extreme values")
    reached = contacts.reached(stated_mm(answers, prior.axes))
    if made.name != "posterior":  # the other estimators are trained and may miss the limit
        return reached
    inside = contacts.held(*(stated_mm(answers, prior.axes, end) for end in (1, 2)))
    weight = np.broadcast_to(contacts.drawn.weight[:, None], inside.shape[:2])
    shares = [share_of(inside[..., axis], weight) for axis in range(prior.extent.axes)]
    coverage, ratio = min(shares, key=lambda share: share.value), reached.ratio
    if (
        ratio.value - SURE * ratio.standard_error <= MAX_RATIO
        and coverage.value + SURE * coverage.standard_error >= MIN_COVERAGE
    ):
        return reached
    gives_way = scene.plate is None or all(support.stiffness_n_per_mm for support in scene.plate.support_list)
    advice = "state a larger noise" if gives_way else "put the plate on springs at its corners"
    raise NotGoodEnoughError(
        f"with {digits(prior.errors.noise_mm, 3)} {scene.unit} of noise the error is {digits(ratio.value, 3)} times "
        f"the accuracy limit, and {coverage.value:.1%} of positions lie in their 95 % intervals; {advice}"
    )


def _accuracy(
    prior: Prior, run: Run, reached: Reached, surface: Surface, world: World, seed: int, effort: Effort
) -> Accuracy:
    """Return the error of the exported graph and the accuracy limit."""
    percent = 100 / prior.diagonal_mm
    error, least = reached.error_mm.scaled(percent), reached.limit_mm.scaled(percent)
    since_touch = []
    plain = answers_of_means(prior, run, surface, world, reached.error_mm, seed, effort)
    for answer in answers_since_touch(plain, prior, run, surface, world, seed, effort):
        at_once, ringing = answer.error_mm.scaled(percent), answer.ringing_mm
        since_touch.append(
            SinceTouch(
                since_ms=answer.since_ms,
                readings=answer.readings,
                error_percent=at_once.value,
                error_standard_error=at_once.standard_error,
                ringing_percent=None if ringing is None else ringing.value * percent,
                ringing_standard_error=None if ringing is None else ringing.standard_error * percent,
            )
        )
    return Accuracy(
        since_touch=since_touch,
        error_percent=error.value,
        error_standard_error=error.standard_error,
        limit_percent=least.value,
        limit_standard_error=least.standard_error,
        ratio_standard_error=reached.ratio.standard_error,
    )


def _golden(prior: Prior, run: Run, seed: int) -> Golden:
    """Return the answers of the graph for a few contacts, one with a channel missing, one unsteady, and for rest."""
    drawn = draw(prior, GOLDEN_DRAWS, seed)
    linear = np.concatenate([drawn.deflection_mm, drawn.deflection_mm[:2], np.zeros((1, prior.channels))])
    deflection = prior.measured(linear)
    covariance = np.tile(np.eye(prior.channels) * prior.errors.noise_mm**2, (len(deflection), 1, 1))
    # A load that has just come: its own deflection scatters.
    covariance[GOLDEN_DRAWS] += np.outer(linear[GOLDEN_DRAWS], linear[GOLDEN_DRAWS]) / 4
    valid = np.ones(deflection.shape, np.bool_)
    if prior.channels > 1:
        valid[GOLDEN_DRAWS + 1, 0], deflection[GOLDEN_DRAWS + 1, 0] = False, 0.0
    weights = prior.errors.whitening(deflection, covariance, valid).astype(np.float32)
    deflection = deflection.astype(np.float32)
    answers = run(deflection, weights)
    return Golden(
        deflection_mm=deflection.astype(float).tolist(),
        whitening_per_mm=weights.astype(float).tolist(),
        answers={name: values.astype(float).tolist() for name, values in answers.items()},
    )
