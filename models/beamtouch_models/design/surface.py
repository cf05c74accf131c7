"""One surface: a scene resolved once, and everything that follows from it.

`resolve` prices the physical effects of a scene and leaves out the negligible ones. What comes after it knows only the
result: influence, errors, filter, sensor and rules of the layout. A model file adds its layout, its floor and the
departures of its calibration (`calibrated`). Physics ends here: placement, limits and estimators take an
`InfluenceFunction` or a `Prior`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import pdist

from beamtouch_common.digits import digits
from beamtouch_common.units import MM, direction_of
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import rate_per_sample, readings_alike
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.physics.beam import check_small_angles, sensor_positions_mm
from beamtouch_models.design.physics.characteristic_fit import Characteristic
from beamtouch_models.design.physics.influence_function import InfluenceFunction, Travel, check_own, travel_of
from beamtouch_models.design.physics.measured_structure import measured_structure_of
from beamtouch_models.design.physics.motion import slowest_period_ms
from beamtouch_models.design.physics.plate import places_of_sensors
from beamtouch_models.design.physics.structure import Structure, characteristics_of, influence_of, structure_of
from beamtouch_models.design.placement.layout_rules import LayoutRules, equal_layout
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim
from beamtouch_models.design.placement.position_error import Sampling
from beamtouch_models.design.pricing.aliases import unseen_of, unseen_swing
from beamtouch_models.design.pricing.effect import Effect
from beamtouch_models.design.pricing.noise import ReadingErrors, chain_of, check_errors, choose_filter, step_mm
from beamtouch_models.design.pricing.of_plates import check_linear
from beamtouch_models.design.pricing.prices import effects_of, without_negligible
from beamtouch_models.design.pricing.ringing import Ringing, ringing_of
from beamtouch_models.design.scene import Scene, parse_scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.plausible_plate import xy_of
from beamtouch_models.design.scene.tables import MAX_SENSORS
from beamtouch_models.errors import SceneError, require
from beamtouch_models.filters import Chain
from beamtouch_models.names import Criterion
from beamtouch_models.numbers import at_least, at_most, number, whole
from beamtouch_models.places import Place, grid_of, in_rows, on_axis
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.metadata import Metadata
from beamtouch_models.runtime.metadata_parts import FilterChoice, Noise, Sensor

if TYPE_CHECKING:
    from beamtouch_models.design.layout import Layout

DEFAULT_ADC_BITS = 16
COARSEST = 100
"""Candidates for a sensor along the longer axis of a plate, at most: a finer grid takes long and wins nothing."""
BEYOND = 1.001
"""Smallest distance of neighbours over the mounting tolerance: just more than `check_spacing` refuses."""


@dataclass(frozen=True, eq=False, repr=False)
class Surface:
    """A scene with what follows from it, as `resolve` returns it.

    Attributes
    ----------
    scene : the scene as stated
    filter : the filter of the daemon that uses the scene's latency
    travel : `largest_mm`, `lift_mm`, `fall_mm` and `slope` (rad) of the structure under the largest force
    readings : errors of single readings, as standard deviations: `reading_mm`, `gain` (relative), `drift_mm`
    errors : errors of a sample, the mean that the filter makes: `noise_mm`, and what no mean takes away, `gain` and
        `zero_mm` (both also if the scene states none: 0.3 %, and a fifth of the noise of a reading), `mounting_mm`
    effects : physical effects with their prices; `in` the model, or left `out` because all that is left out costs less
        than a tenth of the noise together, or in the `floor` of each sample's errors, or `not modelled`: then intervals
        are wide while the effect lasts, or the reason says what to do
    ringing : how the beam or plate rings, and for how long; None if its mass is not stated
    sensor : range and stand-off in mm, and ADC, of each sensor
    influence : deflection per newton, as a function of sensor and load

    >>> for effect in surface.effects:
    ...     if effect.price and effect.price > 1:
    ...         print(f"{effect.name}: {effect.price:.3g} times the noise of a sample")
    dynamics: 262 times the noise of a sample
    gain error: 7.57 times the noise of a sample
    drift in a minute: 2.8 times the noise of a sample
    >>> surface.place(2, effort=0.01)
    Layout(sensors at 49, 339 mm)
    """

    scene: Scene
    filter: FilterChoice
    travel: Travel
    readings: ReadingErrors
    effects: tuple[Effect, ...]
    """Empty if a sample has no noise, which leaves nothing to compare them to. Those of beams have no part in an
    influence function of the user's own, which holds them all."""
    modelled: Scene
    """The scene without its negligible effects."""
    influence: InfluenceFunction
    """Of the beam of `modelled`, or the user's own."""
    sampling: Sampling
    """Errors, rate and readings of samples, which decide what loads a layout tells from one contact."""
    rules: LayoutRules
    """Allowed positions of sensors. Housings do not overlap, and neighbours are farther apart than their mounting
    tolerance: they do not change places."""

    @property
    def beam(self) -> Beam:
        """The beam, without its negligible effects; SceneError if the structure is none."""
        return self.modelled.beam

    @property
    def structure(self) -> Structure:
        """The structure, a beam or a plate without its negligible effects; SceneError if the scene states none."""
        return structure_of(self.modelled)

    @property
    def contact_width_mm(self) -> float:
        """Length over which a contact presses; 0 if it is negligible."""
        return self.modelled.contact.width_mm

    @property
    def held_mm(self) -> tuple[float, ...]:
        """Places at which the structure is known to be held."""
        return held_mm_of(self.scene)

    @property
    def errors(self) -> Errors:
        """Errors of a sample."""
        return self.sampling.errors

    @property
    def touch_rate(self) -> float:
        """Probability of a sample at rest to be taken for a contact, which the thresholds of touch are for."""
        per_day, rate_hz = self.scene.requirements.false_contacts_per_day, self.scene.sensors.rate_hz
        return float(rate_per_sample(per_day, rate_hz, self.filter.window))

    @property
    def noise(self) -> Noise:
        """Noise of a reading and of a sample."""
        return self.readings.behind(self.filter)

    @cached_property
    def sensor(self) -> Sensor:
        """The sensor, its ADC and its stand-off; SceneError if the beam leaves the sensor's range."""
        return _sensor_of(self.scene, self.travel)

    @cached_property
    def slowest_period_ms(self) -> float | None:
        """The longest period in which readings seem to swing; None without a beam or plate whose mass is stated."""
        return slowest_period_ms(self.scene) if self.scene.is_computed else None

    @property
    def slowest_period(self) -> float:
        """The longest period in which readings seem to swing, in readings; 0 without a mass."""
        return (self.slowest_period_ms or 0.0) * self.scene.sensors.rate_hz / 1e3

    @cached_property
    def unseen_swing(self) -> float:
        """The swing of the structure that readings do not show, over that which they show."""
        return unseen_swing(self.scene, self.readings.reading_mm) if self.scene.is_computed else unseen_of(())

    @property
    def ringing(self) -> Ringing | None:
        """Return how long the structure rings; None without a beam or plate whose mass is stated."""
        if not self.scene.is_computed:
            return None
        return ringing_of(self.scene, self.readings.reading_mm, self.travel.largest_mm)

    def characteristics_of(self, sensor_mm: Floats) -> tuple[Characteristic, ...]:
        """Return the characteristics of curved sensors at positions (channels,); none of straight ones."""
        return characteristics_of(self.scene, sensor_mm)

    def __repr__(self) -> str:
        """Return what the surface is: its size, its contacts, and the noise of a sample."""
        weak, strong = self.influence.force_n
        forces, noise_mm = f"{weak:g}" if weak == strong else f"{weak:g}..{strong:g}", digits(self.errors.noise_mm, 3)
        size = " x ".join(f"{length:g}" for length in self.influence.size_mm)
        places = ", ".join(f"{low:g}..{high:g}" for low, high in self.influence.extent.ranges_mm)
        long = " long" if self.influence.extent.axes == 1 else ""
        contacts = f"contacts at {places} mm with {forces} N"
        return f"Surface({size} mm{long}, {contacts}, {noise_mm} {self.scene.unit} of noise a sample)"

    def place(
        self,
        sensors: int | None = None,
        *,
        criterion: Criterion = DEFAULT_AIM.criterion,
        failed_percent: float | None = None,
        seed: int = 0,
        effort: float = 1.0,
    ) -> Layout:
        """Place sensors under the beam, as `design-sensors place` does.

        Parameters
        ----------
        sensors : number of sensors; default: as the scene states
        criterion : "position-error" makes the accuracy limit least, among the layouts that detect two contacts and
            distributed loads as often as that of "eigenvalue-product", the paper's
        failed_percent : share of the time, 0 to 100, in which the worst single sensor has failed, and the error is
            that of the others; default: as the scene requires; only with "position-error"
        seed : seed of the search; the same seed gives the same layout
        effort : share of the usual work, from 0.01 to 100; less is quicker, and may miss the best layout

        Raises
        ------
        SceneError
            No surface can be built of the scene, or its rules allow no layout with this number of sensors.
        """
        # A layout knows its surface, so this step forward is imported when it is taken.
        from beamtouch_models.design.layout import place_sensors  # noqa: PLC0415

        count = None if sensors is None else whole(sensors, "sensors", 1)
        share = None if failed_percent is None else number(failed_percent, "failed_percent")
        aim = Aim(criterion, share, effort=Effort(number(effort, "effort")))
        return place_sensors(self, count=count, seed=whole(seed, "seed", 0), aim=aim)

    def layout(self, positions_mm: ArrayLike) -> Layout:
        """Return the layout of sensors, in the order of the channels.

        Sensors stand at positions (sensors,) in mm from the left end, or at places (sensors, 2) of a plate.

        Raises
        ------
        SceneError
            No surface can be built of the scene, or its sensors cannot stand there.
        """
        from beamtouch_models.design.layout import layout_at  # noqa: PLC0415

        return layout_at(self, positions_mm)

    def chain(self, channels: int) -> Chain:
        """Return the filter for this number of channels, as the daemon runs it."""
        sensors = self.scene.sensors
        per_count_mm = step_mm(sensors.range_mm, sensors.adc_bits or DEFAULT_ADC_BITS)
        seen = self.slowest_period, self.unseen_swing
        return chain_of(self.filter, channels, self.noise.reading_mm, per_count_mm, *seen)

    def prior(self, sensor_mm: Floats) -> Prior:
        """Return the prior of the surface with sensors at positions (channels,) or places (channels, axes), in mm."""
        return Prior.of(self.influence, np.reshape(sensor_mm, (len(sensor_mm), -1)), self.errors)

    def check(self, count: int | None = None) -> None:
        """Refuse a scene of which no surface can be built.

        Parameters
        ----------
        count : number of sensors; None: as the scene states. If the scene leaves it open, one possible number is
            enough.

        Raises
        ------
        SceneError
            The noise is 0, the beam deflects too far for the sensors' range, or no layout keeps the rules of sensors.
        """
        scene = self.scene
        if count is not None and count > MAX_SENSORS:
            raise SceneError(f"sensors = {count}: give at most {MAX_SENSORS} sensors")
        if self.readings.reading_mm == 0:
            raise SceneError("sensors: with a noise of 0 there are no intervals; state the noise of a reading")
        _sensor_of(scene, self.travel)
        fewest = min(scene.fewest, scene.count_range[1])
        equal_layout(self.rules, self.influence.size_mm, count or fewest)

    def check_spacing(self, place_mm: Floats) -> None:
        """Raise SceneError if the mounting tolerance lets neighbours among places (sensors, axes) change places."""
        tolerance_mm = self.scene.sensors.mounting_tolerance_mm
        spacing_mm = float(pdist(place_mm).min(initial=np.inf))
        if tolerance_mm >= spacing_mm:
            raise SceneError(
                f"sensors.mounting_tolerance_mm = {tolerance_mm:g}: two of the sensors are {digits(spacing_mm, 3)} mm "
                "apart; measure their positions to less than that, or state a larger min_distance_mm"
            )


def resolve(scene: Scene, *, influence: InfluenceFunction | None = None, chosen: FilterChoice | None = None) -> Surface:
    """Return the surface of a scene: price its effects, leave out the negligible ones, and compute what follows.

    Parameters
    ----------
    scene : what `read_scene` returns
    influence : an influence function of your own, for a scene without a beam. All that follows from deflections, such
        as a noise in percent of the largest, follows from it.
    chosen : the filter of a model that exists; default: the one that uses all of the latency

    Raises
    ------
    SceneError
        The beam cannot be computed, or deflects too far for small-angle theory; no reading fits in the latency; the
        noise or the drift of zeros is out of proportion to the deflection; the influence function is for other
        contacts; or the scene has both a beam and an influence function, or neither.

    Examples
    --------
    >>> resolve(scene)
    Surface(400 mm long, contacts at 10..390 mm with 2..20 N, 0.000894 mm of noise a sample)
    """
    require(scene, Scene, "scene", "what read_scene or make_scene returns")
    stated = _structure_of(scene, influence)
    travel = travel_of(stated)
    readings, rules = readings_of(scene, travel.largest_mm), rules_of(scene, stated.size_mm)
    chosen = chosen or choose_filter(scene, readings.reading_mm)
    effects: tuple[Effect, ...] = ()
    if readings.reading_mm > 0:
        if scene.has_beam:
            check_small_angles(travel, scene.sensors.range_mm[1] - scene.sensors.range_mm[0])
        if scene.plate is not None:
            check_linear(scene, scene.plate)
        check_errors(scene, readings, chosen, travel.largest_mm)
        effects = effects_of(scene, stated, chosen, readings, rules.place_mm)
    modelled, sensors, noise = without_negligible(scene, effects), scene.sensors, readings.behind(chosen)
    errors = Errors(noise.sample_mm, readings.gain, readings.floor_mm, modelled.sensors.mounting_tolerance_mm)
    return Surface(
        scene=scene,
        filter=chosen,
        travel=travel,
        readings=readings,
        effects=effects,
        modelled=modelled,
        influence=influence or influence_of(modelled),
        sampling=Sampling(errors, chosen.min_noise_mm(noise), sensors.rate_hz, readings_alike(chosen)),
        rules=rules,
    )


def _structure_of(scene: Scene, influence: InfluenceFunction | None) -> InfluenceFunction:
    """Return the influence function of a scene's structure as stated, or that which takes its place."""
    if influence is None:
        return influence_of(scene)
    check_own(influence, scene.contact.ranges_mm, scene.contact.force_range_n)
    structures = ("beam", scene.has_beam), ("plate", scene.plate is not None), ("measured", scene.measured is not None)
    for name, is_stated in structures:
        if is_stated:
            raise SceneError(
                f"{name}: an influence function of your own takes its place, so that nothing may follow from both; "
                f"take it away, with change_scene(scene, {name}=None)"
            )
    return influence


def readings_of(scene: Scene, max_deflection_mm: float) -> ReadingErrors:
    """Return the errors of a scene's readings; those of curved sensors are straightened as where they are largest."""
    readings = ReadingErrors.of(scene, max_deflection_mm)
    if scene.measured is None or not scene.measured.curved:
        return readings
    structure, contact = measured_structure_of(scene), scene.contact
    return readings.scaled(structure.steepest(contact.ranges_mm, contact.force_range_n))


def held_mm_of(scene: Scene) -> tuple[float, ...]:
    """Return the places at which the structure of a scene is known to be held."""
    return scene.beam.held_mm if scene.has_beam else ()


def rules_of(scene: Scene, size_mm: Floats) -> LayoutRules:
    """Return where sensors may stand on a structure of this size; SceneError as `sensor_positions_mm`.

    Those of a measured structure stand where they were measured, those of a plate of the user's own on a grid.
    """
    sensors = scene.sensors
    if scene.measured is not None:
        places = sorted(scene.measured.places_mm.values())
        stated: list[Place] = [*sensors.fixed_mm, *map(xy_of, sensors.fixed)]
        fixed = sorted(places.index(place) for place in stated)
        return LayoutRules(in_rows(places, len(size_mm)), np.array(fixed, dtype=np.intp), 0.0)
    distance_mm = max(sensors.size_mm, sensors.min_distance_mm, BEYOND * sensors.mounting_tolerance_mm)
    if scene.plate is not None:
        return LayoutRules(*places_of_sensors(scene.plate, sensors), distance_mm)
    if len(size_mm) > 1:
        half_mm, step_mm = sensors.size_mm / 2, max(sensors.grid_mm, float(size_mm.max()) / COARSEST)
        ticks = [np.arange(half_mm, length - half_mm + 1e-9 * length, step_mm) for length in size_mm]
        return LayoutRules(grid_of(ticks), np.empty(0, dtype=np.intp), distance_mm)
    allowed_mm = sensor_positions_mm(sensors, float(size_mm[0]), held_mm_of(scene))
    return LayoutRules(on_axis(allowed_mm), np.searchsorted(allowed_mm, np.unique(sensors.fixed_mm)), distance_mm)


def resolve_model(metadata: Metadata) -> Surface:
    """Return the surface of a model's scene behind the model's filter; raises SceneError as `resolve`."""
    return _resolve_text(metadata.scene, f"the scene in {metadata.name}", metadata.filter)


@lru_cache(maxsize=8)  # a calibration asks four times, and a challenge once for each of its tasks
def _resolve_text(text: str, origin: str, chosen: FilterChoice) -> Surface:
    return resolve(parse_scene(text, origin), chosen=chosen)


def _sensor_of(scene: Scene, travel: Travel) -> Sensor:
    """Return sensor, ADC and stand-off of a scene; SceneError if the structure leaves the sensor's range."""
    what = "beam" if scene.has_beam else "structure" if scene.plate is None else "plate"
    (low, high), unit = scene.sensors.range_mm, scene.unit
    lift, fall = travel.lift_mm, travel.fall_mm
    towards = direction_of(unit)
    centred_mm, stated_mm = (low + high) / 2 - towards * (fall - lift) / 2, scene.sensors.standoff_mm
    if fall + lift > high - low:
        excess = (fall + lift) / (high - low)
        or_else = "" if scene.measured is None else f"convert its table if that is not in {unit}, "
        raise SceneError(
            f"at {travel.force_n:g} N the {what} travels {digits(fall + lift, 4)} {unit} and leaves sensors.range_mm = "
            f"[{low:g}, {high:g}]; end contact.force_n at {at_most(travel.force_n / excess):g} N, make the {what} "
            f"{at_least(excess):g} times as stiff, {or_else}or use a sensor with a longer range"
        )
    if unit != MM and low <= -lift <= fall <= high:
        centred_mm = 0.0  # a bridge is balanced at rest
    ends_mm = [] if stated_mm is None else [stated_mm + towards * fall, stated_mm - towards * lift]
    if stated_mm is not None and not low <= min(ends_mm) <= max(ends_mm) <= high:
        raise SceneError(
            f"from sensors.standoff_mm = {stated_mm:g} the {what} leaves sensors.range_mm = [{low:g}, {high:g}]; "
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
