"""One surface: a scene, or the scene in a model file, resolved once for everybody.

Noise, filter, physical effects, influence, errors, sensor, rules of sensors and travel follow from a scene; each is
computed when it is first asked for, and handed on from here. A model file adds its layout, its floor and the departures
of its calibration. Physics ends here: what comes after takes an `InfluenceFunction` or a `Prior`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Self

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior, SampleErrors
from beamtouch_models.design.accuracy.thresholds import rate_per_sample, readings_alike
from beamtouch_models.design.physics.beam import Travel, influence, influence_of, sensor_positions_mm, travel_of
from beamtouch_models.design.physics.influence import InfluenceFunction, check_own
from beamtouch_models.design.physics.motion import slowest_period_ms
from beamtouch_models.design.placement.layout import LayoutRules, equal_layout
from beamtouch_models.design.pricing.aliases import unseen_swing
from beamtouch_models.design.pricing.noise import ReadingErrors, chain_of, check_errors, choose_filter, step_mm
from beamtouch_models.design.pricing.prices import Effect, effects_of, leave_out
from beamtouch_models.design.pricing.ringing import Ringing, ringing_of
from beamtouch_models.design.scene import Scene, parse_scene
from beamtouch_models.design.scene.beam import Beam, changed_beam
from beamtouch_models.errors import SceneError
from beamtouch_models.filters import Chain
from beamtouch_models.numbers import at_least, at_most
from beamtouch_models.runtime.metadata import Departures, FilterChoice, Metadata, Noise, Sensor

DEFAULT_ADC_BITS = 16
BEYOND = 1.001
"""Smallest distance of neighbours over the mounting tolerance: just more than `check_spacing` refuses."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A scene behind the filter of its model, with all that follows from it."""

    stated: Scene
    """The scene as the user states it."""
    filter: FilterChoice
    travel: Travel
    """Of the stated beam."""
    readings: ReadingErrors
    """Errors of readings as the scene states them."""
    own_influence: InfluenceFunction | None = None
    """Measured, or computed elsewhere; None: it follows from the scene."""

    @classmethod
    def of(
        cls, scene: Scene, chosen: FilterChoice | None = None, own_influence: InfluenceFunction | None = None
    ) -> Self:
        """Return the surface of a scene behind a filter; None: the one that uses all of the latency.

        An influence function of the user's own takes the place of that of the scene's beam.

        Raises
        ------
        SceneError
            The beam cannot be computed, no reading fits in the latency, or the influence function is of another length
            or for other contacts. The properties raise it for a beam that cannot be computed.
        """
        if own_influence is not None:
            check_own(own_influence, scene.beam.length_mm, scene.contact.position_mm, scene.contact.force_range_n)
        travel = travel_of(scene)
        readings = ReadingErrors.of(scene, travel.largest_mm)
        return cls(scene, chosen or choose_filter(scene, readings.reading_mm), travel, readings, own_influence)

    @classmethod
    def of_model(cls, metadata: Metadata) -> Self:
        """Return the surface of a model's scene behind the model's filter; raises SceneError as `of`."""
        return cls.of(parse_scene(metadata.scene, f"the scene in {metadata.name}"), metadata.filter)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """All effects with their prices.

        Empty if a sample has no noise, which leaves nothing to compare them to, and with an influence of the user's
        own, which has all effects.
        """
        if self.readings.reading_mm == 0 or self.own_influence is not None:
            return ()
        return effects_of(self.stated, self.filter, self.readings, self._allowed_mm)

    @cached_property
    def scene(self) -> Scene:
        """The scene without its negligible effects; without noise, all of it."""
        return leave_out(self.stated, self.effects, self.readings)

    @cached_property
    def modelled_travel(self) -> Travel:
        """Travel of the beam without the negligible effects."""
        same = (self.scene.beam, self.scene.contact) == (self.stated.beam, self.stated.contact)
        return self.travel if same else travel_of(self.scene)

    @cached_property
    def modelled_readings(self) -> ReadingErrors:
        """Errors of readings without the negligible effects."""
        return ReadingErrors.of(self.scene, self.modelled_travel.largest_mm)

    @property
    def touch_rate(self) -> float:
        """Probability of a sample at rest to be taken for a contact, which the thresholds of touch are for."""
        stated = self.stated
        per_day, rate_hz = stated.requirements.false_contacts_per_day, stated.sensors.rate_hz
        return rate_per_sample(per_day, rate_hz, self.filter.window)

    @property
    def noise(self) -> Noise:
        """Noise of a reading and of a sample."""
        return self.modelled_readings.behind(self.filter)

    @cached_property
    def influence(self) -> InfluenceFunction:
        """The influence, without the negligible effects."""
        return self.own_influence or influence_of(self.scene)

    @cached_property
    def errors(self) -> SampleErrors:
        """The errors of a sample: its noise, and what readings leave in every mean."""
        noise, readings = self.noise, self.modelled_readings
        return SampleErrors(
            noise.sample_mm,
            readings.gain,
            readings.floor_mm,
            self.scene.sensors.mounting_tolerance_mm,
            self.filter.min_noise_mm(noise),
            self.scene.sensors.rate_hz,
            readings_alike(self.filter),
        )

    @cached_property
    def rules(self) -> LayoutRules:
        """Where sensors may stand.

        Housings do not overlap, and neighbours are farther apart than their mounting tolerance: they do not change
        places.
        """
        return self._rules_of(self.scene)

    @cached_property
    def sensor(self) -> Sensor:
        """The sensor, its ADC and its stand-off; SceneError if the beam leaves the sensor's range."""
        return _sensor_of(self.scene, self.modelled_travel)

    @cached_property
    def slowest_period_ms(self) -> float | None:
        """The longest period in which readings seem to swing; None if the beam's mass is not stated."""
        return slowest_period_ms(self.stated)

    @property
    def slowest_period(self) -> float:
        """The same in readings; 0 if the beam's mass is not stated."""
        return (self.slowest_period_ms or 0.0) * self.stated.sensors.rate_hz / 1e3

    @cached_property
    def unseen_swing(self) -> float:
        """The swing of the beam that readings do not show, over that which they show."""
        return unseen_swing(self.stated, self.readings.reading_mm)

    @property
    def ringing(self) -> Ringing | None:
        """How long the beam rings; None if its mass is not stated."""
        return ringing_of(self.stated, self.readings.reading_mm, self.travel.largest_mm)

    def chain(self, channels: int) -> Chain:
        """Return the filter for this number of channels, as the daemon runs it."""
        sensors = self.stated.sensors
        per_count_mm = step_mm(sensors.range_mm, sensors.adc_bits or DEFAULT_ADC_BITS)
        seen = self.slowest_period, self.unseen_swing
        return chain_of(self.filter, channels, self.noise.reading_mm, per_count_mm, *seen)

    def prior(self, sensor_mm: Floats) -> Prior:
        """Return the prior of the surface with sensors at positions (channels,), in mm."""
        return Prior.real(self.influence, sensor_mm, self.errors)

    def check(self, count: int | None = None) -> None:
        """Refuse a scene of which no surface can be built.

        Parameters
        ----------
        count : number of sensors; None: as the scene states. If the scene leaves it open, one possible number is
            enough.

        Raises
        ------
        SceneError
            The beam deflects too far for small-angle theory or for the sensors' range, the noise is 0, the noise or the
            drift of zeros is out of proportion to the deflection, or no layout keeps the rules of sensors.
        """
        scene, sensors = self.stated, self.stated.sensors
        self.travel.check_small_angles(sensors.range_mm[1] - sensors.range_mm[0])
        if self.readings.reading_mm == 0:
            raise SceneError("sensors: with a noise of 0 there are no intervals; state the noise of a reading")
        check_errors(scene, self.readings, self.filter, self.travel.largest_mm)
        _sensor_of(scene, self.travel)
        fewest = min(sensors.fewest, sensors.count_range[1])
        equal_layout(self._rules_of(scene), scene.beam.length_mm, count or fewest)

    def check_spacing(self, positions_mm: Sequence[float]) -> None:
        """Raise SceneError if the mounting tolerance lets neighbouring sensors change places."""
        tolerance_mm = self.scene.sensors.mounting_tolerance_mm
        spacing_mm = float(np.diff(np.sort(positions_mm)).min(initial=np.inf))
        if tolerance_mm >= spacing_mm:
            raise SceneError(
                f"sensors.mounting_tolerance_mm = {tolerance_mm:g}: two of the sensors are {digits(spacing_mm, 3)} mm "
                "apart; measure their positions to less than that, or state a larger min_distance_mm"
            )

    @cached_property
    def _allowed_mm(self) -> Floats:
        """(positions,) where a sensor may stand; no effect changes them."""
        return sensor_positions_mm(self.stated)

    def _rules_of(self, scene: Scene) -> LayoutRules:
        sensors, allowed_mm = scene.sensors, self._allowed_mm
        distance_mm = max(sensors.size_mm, sensors.min_distance_mm, BEYOND * sensors.mounting_tolerance_mm)
        return LayoutRules(allowed_mm, np.searchsorted(allowed_mm, np.unique(sensors.fixed_mm)), distance_mm)


def _sensor_of(scene: Scene, travel: Travel) -> Sensor:
    """Return sensor, ADC and stand-off of a scene; SceneError if the beam leaves the sensor's range."""
    low, high = scene.sensors.range_mm
    lift, fall = travel.lift_mm, travel.fall_mm
    centred_mm, stated_mm = (low + high) / 2 + (fall - lift) / 2, scene.sensors.standoff_mm
    if fall + lift > high - low:
        excess = (fall + lift) / (high - low)
        raise SceneError(
            f"at {travel.force_n:g} N the beam travels {digits(fall + lift, 4)} mm and leaves sensors.range_mm = "
            f"[{low:g}, {high:g}]; end contact.force_n at {at_most(travel.force_n / excess):g} N, make the beam "
            f"{at_least(excess):g} times as stiff, or use a sensor with a longer range"
        )
    if stated_mm is not None and (stated_mm - fall < low or stated_mm + lift > high):
        raise SceneError(
            f"from sensors.standoff_mm = {stated_mm:g} the beam leaves sensors.range_mm = [{low:g}, {high:g}]; "
            f"write standoff_mm = {digits(centred_mm, 4)}, or leave it out"
        )
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


def prior_of_model(metadata: Metadata) -> Prior:
    """Return the prior of a model's surface, with its layout, its floor and the departures of its calibration.

    Raises
    ------
    SceneError
        The scene in the model cannot be computed.
    """
    surface, sensor_mm = Surface.of_model(metadata), metadata.layout_mm
    floor = metadata.floor
    prior = replace(
        surface.prior(sensor_mm),
        noise_mm=metadata.noise.sample_mm,
        gain=np.array(floor.gain),
        zero_mm=np.array(floor.zero_mm),
    )
    if metadata.calibration is None:
        return prior
    # A calibration finds the positions of the sensors.
    prior = replace(prior, uncertain_at=None)
    contact = surface.scene.contact
    return depart(prior, surface.scene.beam, contact.width_mm, sensor_mm, metadata.calibration.departures)


def depart(prior: Prior, beam: Beam, width_mm: float, sensor_mm: Floats, departures: Departures) -> Prior:
    """Return the prior of a surface that differs from its scene, with its beam, width of contact and sensors.

    Its deflections are linear in the force and hold the gains; `measured` adds curve and offsets.
    """
    real = changed_beam(beam, departures.rigidity, departures.fixity)
    true_mm = departures.sensors_mm(sensor_mm, beam.length_mm)
    influence_at = partial(_real_influence, np.array(departures.gain), real, true_mm, width_mm)
    return replace(prior, influence_at=influence_at, measured=departures.measure)


def _real_influence(gain: Floats, beam: Beam, true_mm: Floats, width_mm: float, load_mm: Floats) -> Floats:
    matrix: Floats = gain * influence(beam, true_mm, load_mm, width_mm)
    return matrix
