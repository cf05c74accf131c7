"""Placement of sensors: an objective and a search, and the number of sensors that a structure needs."""

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from beamtouch_common.digits import Rounded, digits
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.accuracy.limit import accuracy_limit, limits_without
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.eigenvalue_product import (
    discernible,
    eigenvalue_product_of,
    log_eigenvalue_product,
    principal_components,
)
from beamtouch_models.design.placement.layout_rules import LayoutRules, equal_layout, equal_pitch_mm
from beamtouch_models.design.placement.least_error import in_pairs, search_stages, stages_of
from beamtouch_models.design.placement.position_error import Sampling
from beamtouch_models.design.placement.search import first_best, search_from
from beamtouch_models.design.sweeps import Progress, one_thread, silent
from beamtouch_models.errors import NotGoodEnoughError, SceneError
from beamtouch_models.names import CRITERIA, Criterion, SearchName
from beamtouch_models.places import Place, as_stated, positions_of

AT_REST = 1e-12
"""Largest deflection at a support, over that elsewhere: rounding."""
PROBES = 8
"""Equally pitched sensors whose components are counted, as in the paper."""
ALWAYS = 100.0
"""Percentage of the time that is all of it."""
COUNT_DRAWS = 1_000
"""Simulated contacts for the error of each number of sensors that is tried; a small effort buys no other number."""


@dataclass(frozen=True)
class Aim:
    """The goal of a placement, and the way in which it searches.

    Raises
    ------
    SceneError
        There is no such criterion, or the share is not one, or stated for the eigenvalue product.
    """

    criterion: Criterion
    failed_percent: float | None = None
    """Share of the time, 0 to 100, in which a position error is that with the worst sensor failed; None: that which the
    scene requires, and 0 without a scene."""
    leading: int | None = None
    """Number of eigenvalues in the product; None: all."""
    search: SearchName = "exchange"
    effort: Effort = USUAL
    """How long it searches."""

    def __post_init__(self) -> None:
        if self.criterion not in CRITERIA:
            raise SceneError(f"criterion = {self.criterion!r} must be one of {', '.join(CRITERIA)}")
        if self.failed_percent is None:
            return
        if not 0 <= self.failed_percent <= ALWAYS:
            raise SceneError(f"failed_percent = {self.failed_percent:g}: give a share of the time, from 0 to 100")
        if self.criterion != "position-error":
            raise SceneError(
                f"failed_percent = {self.failed_percent:g}: it weighs position errors, and goes with no other "
                "criterion and no number of components; leave one of them out"
            )

    @property
    def fewest(self) -> int:
        """Fewest sensors that such a layout has."""
        return max(2 if self.failed_percent == ALWAYS else 1, self.leading or 1)


DEFAULT_AIM = Aim(CRITERIA[0])
"""Its error is smaller, and it notices loads that are not one contact as often (decision 024)."""


@dataclass(frozen=True, eq=False, repr=False)
class Placement(Rounded):
    """A layout, and the search that found it."""

    place_mm: Floats
    """(sensors, axes), ascending by the first axis."""
    log_eigenvalue_product: float
    """Natural logarithm of the product of the leading eigenvalues, with deflections per newton in the structure's
    `unit_mm_per_n`: for a beam, lengths in units of l and W/(EI) = 1. Minus infinity if rounding hides one of them,
    which can happen with the position-error criterion only."""
    evaluations: int
    """Number of layouts scored."""

    @property
    def positions_mm(self) -> tuple[float, ...]:
        """The places on a beam, from the left end."""
        return tuple(positions_of(self.place_mm).tolist())

    @property
    def places(self) -> list[Place]:
        """The places as a user states them: positions on a beam, pairs on a plate."""
        stated = as_stated(self.place_mm).tolist()
        return [place if isinstance(place, float) else tuple(place) for place in stated]


def place_as(
    aim: Aim,
    influence: InfluenceFunction,
    rules: LayoutRules,
    count: int,
    seed: int,
    sampling: Sampling,
    progress: Progress = silent,
) -> Placement:
    """Place sensors as an aim says; arguments and errors as `place_by_position_error`."""
    match aim.criterion:
        case "eigenvalue-product":
            return place(influence, rules, count, seed, aim.leading, search=aim.search, effort=aim.effort)
        case "position-error":
            placement = place_by_position_error(influence, rules, count, seed, sampling, aim, progress)
            if aim.leading is None:
                return placement
            return replace(placement, log_eigenvalue_product=score_layout(influence, placement.place_mm, aim.leading))


def place(
    influence: InfluenceFunction,
    rules: LayoutRules,
    count: int,
    seed: int,
    leading: int | None = None,
    *,
    search: SearchName = "exchange",
    effort: Effort = USUAL,
) -> Placement:
    """Place sensors so that the product of the leading eigenvalues (eq. 4) is largest.

    Parameters
    ----------
    influence, rules : influence function of the structure, and rules for its sensors
    count : number of sensors
    seed : seed of the search
    leading : number of eigenvalues in the product; `count` by default
    search : "exchange" exchanges sensors by steps, "paper" clones and varies a layout
    effort : how long it searches

    Raises
    ------
    SceneError
        The rules allow no layout of `count` sensors, or no layout has `leading` components.
    """
    with one_thread():
        product = eigenvalue_product_of(influence, rules, count, leading)
        runs = search_from(product.starts(seed), product, search, seed, effort=effort)
        best = first_best(runs)
        score = product.exact_score(best.layout)
        if not np.isfinite(score):
            message = f"the rules of sensors leave no {count} positions with independent readings; use fewer sensors"
            raise SceneError(message)
    return _checked(rules, best.layout, score, sum(run.evaluations for run in runs))


def place_by_position_error(
    influence: InfluenceFunction,
    rules: LayoutRules,
    count: int,
    seed: int,
    sampling: Sampling,
    aim: Aim = DEFAULT_AIM,
    progress: Progress = silent,
) -> Placement:
    """Place sensors so that the position error is least of layouts that notice other loads; as `place`.

    The error is that of `position_error`: the accuracy limit with all errors of a sample, the mean, over contacts drawn
    uniformly from the ranges of position and force, of the distance between the contact and the posterior median; for
    the share `failed_percent` of `aim`, that with the worst sensor failed. It is minimised among the layouts that
    detect two contacts and distributed loads as well as the layout of the eigenvalue product, within
    `position_error.SLACK`.

    The noise of `sampling` must not be 0. `aim` has the search, too. `progress` is called with the current step and
    the fraction done. SceneError also if a sensor stands where nothing moves.
    """
    if count < aim.fewest:
        raise SceneError(
            f"failed_percent = {aim.failed_percent or 0:g} needs at least {aim.fewest} sensors, not {count}; use more, "
            "or set sensors.count"
        )
    with one_thread():
        equal = equal_layout(rules, influence.size_mm, count)
        product = equal
        with suppress(SceneError):  # there may be fewer components than sensors
            by_product = eigenvalue_product_of(influence, rules, count)
            product = first_best(
                search_from(by_product.starts(seed), by_product, "exchange", seed, effort=aim.effort)
            ).layout
        share = (aim.failed_percent or 0.0) / ALWAYS
        stages = stages_of(influence, rules, equal, product, sampling, share, seed, aim.effort)
        pairs = in_pairs(rules, influence.size_mm, count)
        starts = [product, equal, *([] if pairs is None else [pairs])]
        layout, scored = search_stages(
            stages, starts, aim.search, seed, lambda part: progress("placing by position error", part), aim.effort
        )
    places = rules.place_mm[layout]
    size = np.abs(influence.matrix(places)).max(axis=0)
    if size.min() <= AT_REST * size.max():
        message = (
            f"sensors: nothing moves at {_in_words(places[size.argmin()])}; move that sensor, or use fewer sensors"
        )
        raise SceneError(message)
    return _checked(rules, layout, score_layout(influence, places), scored)


def _checked(rules: LayoutRules, layout: Indices, score: float, scored: int) -> Placement:
    """Return the result of a search, whatever made it; NotGoodEnoughError if it breaks a rule."""
    places = rules.place_mm[layout]
    if not rules.allowed(layout[None, :])[0]:
        raise NotGoodEnoughError(
            f"the search ended at {', '.join(map(_in_words, places))}, against the rules of sensors; please report "
            "this scene as a defect"
        )
    return Placement(places, score, scored)


def _in_words(place_mm: Floats) -> str:
    return f"{', '.join(f'{number:g}' for number in place_mm)} mm"


def score_layout(influence: InfluenceFunction, place_mm: Floats, leading: int | None = None) -> float:
    """Return the logarithm of the eigenvalue product of sensors at places (sensors, axes).

    Its unit is that of `Placement.log_eigenvalue_product`.
    """
    score = log_eigenvalue_product(influence.matrix(place_mm), leading)
    return score - 2 * (leading or len(place_mm)) * float(np.log(influence.unit_mm_per_n))


def _limit_percent(prior: Prior, aim: Aim, seed: int) -> float:
    """Return the accuracy limit that a requirement is compared with."""
    if aim.failed_percent != ALWAYS:
        return accuracy_limit(prior, COUNT_DRAWS, seed).value
    failed = limits_without(prior, [(index,) for index in range(prior.channels)], COUNT_DRAWS, seed)
    return max(compared.limit.value for compared in failed)


def recommended_count(influence: InfluenceFunction, noise_mm: float) -> int:
    """Return the number of sensors by the paper's section 3: one per component that exceeds the noise.

    The components are those of eight sensors at equal pitch, under forces drawn from their range. The number is
    at least two, because one sensor cannot distinguish a contact from its mirror image.
    """
    low, high = influence.force_n
    force = math.sqrt((low * low + low * high + high * high) / 3)
    matrix = influence.matrix(equal_pitch_mm(influence.size_mm, PROBES))
    size = float(np.abs(matrix).max())
    if size == 0 or force == 0:
        return 2
    return max(2, discernible(principal_components(matrix / size).eigenvalues, noise_mm / size / force))


def fewest_sensors(
    influence: InfluenceFunction,
    rules: LayoutRules,
    counts: tuple[int, int],
    *,
    wanted_mm: float | None,
    sampling: Sampling,
    seed: int,
    aim: Aim = DEFAULT_AIM,
    progress: Progress = silent,
) -> Placement:
    """Place the fewest sensors whose accuracy limit meets a requirement; it is that with all sensors.

    If one has always failed (a `failed_percent` of 100), it is that with the worst one failed.

    Parameters
    ----------
    influence, rules : influence function of the structure, and rules for its sensors
    counts : smallest and largest number of sensors; equal ends need no requirement. Numbers below that of the fixed
        sensors are passed over.
    wanted_mm : largest mean position error
    sampling : the samples, with their errors
    seed : seed of the search and of the simulated contacts
    aim : criterion and search of the layouts
    progress : called with the current step and the fraction done

    Raises
    ------
    SceneError
        The number is open without a requirement, not even the largest number meets the requirement, or there are more
        fixed sensors than that.
    """
    fewest, most = counts
    if fewest == most:
        return place_as(aim, influence, rules, most, seed, sampling, progress)
    if wanted_mm is None:
        raise SceneError(
            "sensors.count leaves the number open; give requirements.position_error_mm, or a number of sensors "
            "(--sensors N)"
        )
    reached_mm = math.inf

    def out_of_reach(count: int, more: str) -> SceneError:
        """Return the error for the largest number of sensors; `more` ends its line."""
        limit = "the accuracy limit with one failed" if aim.failed_percent == ALWAYS else "the accuracy limit"
        wanted = f"requirements.position_error_mm = {wanted_mm:g}"
        return SceneError(f"not even {count} sensors reach {wanted}: {limit} is {digits(reached_mm, 3)} mm; {more}")

    for number in range(min(max(fewest, len(rules.fixed), aim.fewest), most), most + 1):
        try:
            placement = place_as(aim, influence, rules, number, seed, sampling, progress)
        except SceneError as refusal:
            if reached_mm == math.inf:
                raise
            raise out_of_reach(number - 1, f"and {refusal}") from None
        prior = Prior.of(influence, placement.place_mm, sampling.errors)
        reached_mm = _limit_percent(prior, aim, seed) / 100 * influence.diagonal_mm
        if reached_mm <= wanted_mm:
            return placement
    raise out_of_reach(most, "use sensors with less noise or allow more latency_ms")
