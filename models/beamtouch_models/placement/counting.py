"""The number of sensors that a scene needs."""

import math

import numpy as np

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import load_positions_mm, scene_influence
from beamtouch_models.placement.components import discernible, principal_components
from beamtouch_models.placement.layout import equal_pitch_mm
from beamtouch_models.placement.placing import Placement, place
from beamtouch_models.scene import Scene

PROBES = 8
"""Equally pitched sensors whose components are counted, as in the paper."""
COUNT_DRAWS = 1_000


def recommended_count(scene: Scene, noise_mm: float) -> int:
    """Return the number of sensors by the paper's section 3: one per component that exceeds the noise.

    The components are those of eight sensors at equal pitch, under forces drawn from the scene's range. The number is
    at least two, because one sensor cannot distinguish a contact from its mirror image.
    """
    low, high = scene.contact.force_range_n
    force = math.sqrt((low * low + low * high + high * high) / 3)
    matrix = scene_influence(scene, equal_pitch_mm(scene, PROBES), load_positions_mm(scene))
    size = float(np.abs(matrix).max())
    if size == 0 or force == 0:
        return 2
    return max(2, discernible(principal_components(matrix / size).eigenvalues, noise_mm / size / force))


def fewest_sensors(scene: Scene, noise_mm: float, count: int | None, seed: int) -> Placement:
    """Place `count` sensors, or the fewest of the scene's range whose accuracy limit meets its requirement.

    Raises
    ------
    SceneError
        The scene leaves the number open without a requirement, or not even its largest number meets the requirement.
    """
    fewest, most = (count, count) if count else scene.sensors.count_range
    wanted_mm = scene.requirements.position_error_mm
    if fewest != most and wanted_mm is None:
        message = "sensors.count leaves the number open; give requirements.position_error_mm, or --sensors N"
        raise SceneError(message)
    reached_mm = math.inf
    for number in range(fewest, most + 1):
        placement = place(scene, number, seed)
        if fewest == most or wanted_mm is None:
            return placement
        reached = accuracy_limit(Prior.real(scene, np.array(placement.positions_mm), noise_mm), COUNT_DRAWS, seed)
        reached_mm = reached.percent / 100 * scene.beam.length_mm
        if reached_mm <= wanted_mm:
            return placement
    message = (
        f"not even {most} sensors reach requirements.position_error_mm = {wanted_mm:g}: the accuracy limit is "
        f"{reached_mm:.3g} mm; use sensors with less noise or allow more latency_ms"
    )
    raise SceneError(message)
