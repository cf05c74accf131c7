"""The sensors of a scene: rules for their positions, their errors, their range and ADC."""

from collections.abc import Sequence

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.accuracy.prior import SampleErrors
from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import Sensor
from beamtouch_models.physics.beam import sensor_positions_mm, travel_mm
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.pricing.noise import floor_of, step_mm
from beamtouch_models.rounding import at_most
from beamtouch_models.scene import Scene

DEFAULT_ADC_BITS = 16
BEYOND = 1.001
"""Smallest distance of neighbours over the mounting tolerance: just more than `check_spacing` refuses."""


def sensor_rules(scene: Scene) -> Candidates:
    """Return the allowed sensor positions of a scene; raises SceneError if its rules leave fewer than two.

    Housings do not overlap, and neighbours are farther apart than their mounting tolerance: they do not change places.
    """
    position = sensor_positions_mm(scene)
    sensors = scene.sensors
    distance_mm = max(sensors.size_mm, sensors.min_distance_mm, BEYOND * sensors.mounting_tolerance_mm)
    return Candidates(position, np.searchsorted(position, np.unique(scene.sensors.fixed_mm)), distance_mm)


def sample_errors(
    scene: Scene, noise_mm: float, min_noise_mm: float | None = None, windows: tuple[int, ...] = (1,)
) -> SampleErrors:
    """Return the errors of samples with this noise; gain, zero and mounting are those of the scene's sensors.

    `min_noise_mm` is the noise of samples of the most readings; None: the same. `windows` are the readings in the means
    for which the threshold of misfit holds.
    """
    sensors = scene.sensors
    return SampleErrors(
        noise_mm, *floor_of(scene), sensors.mounting_tolerance_mm, min_noise_mm, sensors.rate_hz, windows
    )


def sensor_of(scene: Scene) -> Sensor:
    """Return sensor, ADC and stand-off of a scene; SceneError if the beam leaves the sensor's range."""
    low, high = scene.sensors.range_mm
    lift, travel = travel_mm(scene)
    centred_mm, stated_mm = (low + high) / 2 + (travel - lift) / 2, scene.sensors.standoff_mm
    if travel + lift > high - low:
        force_n = at_most(scene.contact.force_range_n[1] * (high - low) / (travel + lift))
        message = (
            f"the beam travels {digits(travel + lift, 4)} mm and leaves sensors.range_mm = [{low:g}, {high:g}]; end "
            f"contact.force_n at {force_n:g} N, make the beam stiffer, or use a sensor with a longer range"
        )
        raise SceneError(message)
    if stated_mm is not None and (stated_mm - travel < low or stated_mm + lift > high):
        message = (
            f"from sensors.standoff_mm = {stated_mm:g} the beam leaves sensors.range_mm = [{low:g}, {high:g}]; "
            f"write standoff_mm = {digits(centred_mm, 4)}, or leave it out"
        )
        raise SceneError(message)
    bits = scene.sensors.adc_bits or DEFAULT_ADC_BITS
    gain = step_mm(scene.sensors.range_mm, bits)
    return Sensor(
        rate_hz=scene.sensors.rate_hz,
        range_mm=scene.sensors.range_mm,
        standoff_mm=centred_mm if stated_mm is None else stated_mm,
        adc_bits=bits,
        gain_mm_per_count=gain,
        offset_mm=low - 0.1 * (2**bits - 1) * gain,
    )


def check_spacing(scene: Scene, positions_mm: Sequence[float]) -> None:
    """Raise SceneError if the mounting tolerance lets neighbouring sensors change places."""
    tolerance_mm = scene.sensors.mounting_tolerance_mm
    spacing_mm = float(np.diff(np.sort(positions_mm)).min(initial=np.inf))
    if tolerance_mm >= spacing_mm:
        message = (
            f"sensors.mounting_tolerance_mm = {tolerance_mm:g}: two of the sensors are {digits(spacing_mm, 3)} mm "
            "apart; measure their positions to less than that, or state a larger min_distance_mm"
        )
        raise SceneError(message)
