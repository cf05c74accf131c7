"""What a scene states of its sensors: rules for their positions, and their errors."""

from collections.abc import Sequence

import numpy as np

from beamtouch_models.accuracy.prior import SampleErrors
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import sensor_positions_mm
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.pricing.noise import floor_of
from beamtouch_models.scene import Scene


def sensor_rules(scene: Scene) -> Candidates:
    """Return the allowed sensor positions of a scene; raises SceneError if its rules leave fewer than two."""
    position = sensor_positions_mm(scene)
    return Candidates(
        position, np.searchsorted(position, np.unique(scene.sensors.fixed_mm)), scene.sensors.min_distance_mm
    )


def sample_errors(scene: Scene, noise_mm: float) -> SampleErrors:
    """Return the errors of samples with this noise; gain, zero and mounting are those of the scene's sensors."""
    return SampleErrors(noise_mm, *floor_of(scene), scene.sensors.mounting_tolerance_mm)


def check_spacing(scene: Scene, positions_mm: Sequence[float]) -> None:
    """Raise SceneError if the mounting tolerance lets neighbouring sensors change places."""
    tolerance_mm = scene.sensors.mounting_tolerance_mm
    spacing_mm = float(np.diff(np.sort(positions_mm)).min(initial=np.inf))
    if tolerance_mm >= spacing_mm:
        message = (
            f"sensors.mounting_tolerance_mm = {tolerance_mm:g}: two of the sensors are {spacing_mm:.3g} mm apart; "
            "measure their positions to less than that, or state a larger min_distance_mm"
        )
        raise SceneError(message)
