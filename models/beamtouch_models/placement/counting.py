"""The number of sensors that a structure needs."""

import math

import numpy as np

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.components import discernible, principal_components
from beamtouch_models.placement.layout import Candidates, equal_pitch_mm
from beamtouch_models.placement.placing import Placement, place

PROBES = 8
"""Equally pitched sensors whose components are counted, as in the paper."""
COUNT_DRAWS = 1_000


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
) -> Placement:
    """Place the fewest sensors whose accuracy limit meets a requirement.

    Parameters
    ----------
    influence, rules : influence function of the structure, and rules for its sensors
    counts : smallest and largest number of sensors; equal ends need no requirement. Numbers below that of the fixed
        sensors are passed over.
    wanted_mm : largest mean position error
    errors : errors of a sample
    seed : seed of the search and of the simulated contacts

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
    reached_mm = math.inf
    for number in range(min(max(fewest, len(rules.fixed)), most), most + 1):
        placement = place(influence, rules, number, seed)
        if fewest == most or wanted_mm is None:
            return placement
        reached = accuracy_limit(Prior.real(influence, np.array(placement.positions_mm), errors), COUNT_DRAWS, seed)
        reached_mm = reached.percent / 100 * influence.length_mm
        if reached_mm <= wanted_mm:
            return placement
    message = (
        f"not even {most} sensors reach requirements.position_error_mm = {wanted_mm:g}: the accuracy limit is "
        f"{reached_mm:.3g} mm; use sensors with less noise or allow more latency_ms"
    )
    raise SceneError(message)
