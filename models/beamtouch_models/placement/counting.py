"""The number of sensors that a structure needs."""

import math

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.components import discernible, principal_components
from beamtouch_models.placement.layout import Candidates, equal_pitch_mm
from beamtouch_models.placement.placing import DEFAULT_AIM, Aim, Placement, place_as
from beamtouch_models.progress import Progress, silent

PROBES = 8
"""Equally pitched sensors whose components are counted, as in the paper."""
COUNT_DRAWS = 1_000
"""Simulated contacts for the error of each number of sensors that is tried."""


def recommended_count(influence: InfluenceFunction, noise_mm: float) -> int:
    """Return the number of sensors by the paper's section 3: one per component that exceeds the noise.

    The components are those of eight sensors at equal pitch, under forces drawn from their range. The number is
    at least two, because one sensor cannot distinguish a contact from its mirror image.
    """
    low, high = influence.force_n
    force = math.sqrt((low * low + low * high + high * high) / 3)
    matrix = influence.matrix(equal_pitch_mm(influence.length_mm, PROBES))
    size = float(np.abs(matrix).max())
    if size == 0 or force == 0:
        return 2
    return max(2, discernible(principal_components(matrix / size).eigenvalues, noise_mm / size / force))


def fewest_sensors(
    influence: InfluenceFunction,
    rules: Candidates,
    counts: tuple[int, int],
    *,
    wanted_mm: float | None,
    errors: SampleErrors,
    seed: int,
    aim: Aim = DEFAULT_AIM,
    progress: Progress = silent,
) -> Placement:
    """Place the fewest sensors whose accuracy limit meets a requirement; with a spare, whichever one has failed.

    Parameters
    ----------
    influence, rules : influence function of the structure, and rules for its sensors
    counts : smallest and largest number of sensors; equal ends need no requirement. Numbers below that of the fixed
        sensors are passed over.
    wanted_mm : largest mean position error
    errors : errors of a sample
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
    if fewest != most and wanted_mm is None:
        message = "sensors.count leaves the number open; give requirements.position_error_mm, or --sensors N"
        raise SceneError(message)
    if wanted_mm is None or fewest == most:
        return place_as(aim, influence, rules, most, seed, errors, progress)
    reached_mm = math.inf
    for number in range(min(max(fewest, len(rules.fixed), aim.spare + 1, aim.leading or 1), most), most + 1):
        try:
            placement = place_as(aim, influence, rules, number, seed, errors, progress)
        except SceneError as refusal:
            if reached_mm == math.inf:
                raise
            raise _out_of_reach(number - 1, wanted_mm, reached_mm, aim, f"and {refusal}") from None
        prior = Prior.real(influence, np.array(placement.positions_mm), errors)
        priors = [prior, *(prior.without(index) for index in range(number if aim.spare else 0))]
        reached_mm = max(accuracy_limit(one, COUNT_DRAWS, seed).percent for one in priors) / 100 * influence.length_mm
        if reached_mm <= wanted_mm:
            return placement
    remedy = "use sensors with less noise or allow more latency_ms"
    raise _out_of_reach(most, wanted_mm, reached_mm, aim, remedy)


def _out_of_reach(count: int, wanted_mm: float, reached_mm: float, aim: Aim, more: str) -> SceneError:
    """Return the error for a requirement that the largest number of sensors misses; `more` ends its line."""
    limit = "the accuracy limit with one failed" if aim.spare else "the accuracy limit"
    wanted = f"requirements.position_error_mm = {wanted_mm:g}"
    return SceneError(f"not even {count} sensors reach {wanted}: {limit} is {digits(reached_mm, 3)} mm; {more}")
