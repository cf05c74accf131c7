"""The sensors of a surface: placed, or where the user has them; what they can tell, and the model for them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.digits import Rounded, digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy import limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.accuracy.thresholds import (
    PLACES,
    directions,
    noise_at_rest,
    shapes_at_rest,
    smallest_force_n,
    touch_threshold,
)
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.estimators.estimator import Estimator, estimator_of
from beamtouch_models.design.physics.plate import places_on
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim, Placement, fewest_sensors, score_layout
from beamtouch_models.design.pricing.noise import check_scale
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.scene.plausible import too_close
from beamtouch_models.design.scene.plausible_plate import too_close_on_plate, xy_of
from beamtouch_models.design.scene.tables import MAX_SENSORS
from beamtouch_models.design.surface import Surface
from beamtouch_models.design.sweeps import Fraction, Progress, silent
from beamtouch_models.design.world import World
from beamtouch_models.errors import SceneError
from beamtouch_models.names import ESTIMATORS, EstimatorName
from beamtouch_models.numbers import number, numbers, places_within, whole
from beamtouch_models.places import Place, as_stated, in_rows, in_words

if TYPE_CHECKING:
    from beamtouch_models.design.model import Model

POSITIONS = 41
"""Places of contacts along the beam, unless a script names others."""


@dataclass(frozen=True, repr=False)
class ErrorAlong(Rounded):
    """The accuracy limit along the beam, or over a plate: the mean error of contacts at each place, in mm.

    >>> along = layout.error_along([50, 200])
    >>> along.error_mm.round(1), along.standard_error_mm.round(1)
    (array([4.3, 1.5]), array([0.4, 0.1]))
    """

    position_mm: Floats
    """(places,); on a plate (places, 2)."""
    error_mm: Floats
    """(places,)."""
    standard_error_mm: Floats
    """(places,) of each mean, as forces and noise are drawn at random."""


@dataclass(frozen=True, eq=False, repr=False)
class Layout:
    """The sensors of a surface, as `Surface.place` and `Surface.layout` return them.

    >>> layout = surface.layout([130, 270])
    >>> layout
    Layout(sensors at 130, 270 mm)
    >>> print(layout.limit(draws=500), "mm")
    4.74 +- 0.06 mm
    >>> layout.build("strip", effort=0.01).metadata.accuracy.ratio < 1.05
    True
    """

    surface: Surface
    placement: Placement
    """The positions, and the search that found them."""
    aim: Aim
    """The aim for which the layout was placed, and the effort."""

    def __repr__(self) -> str:
        """Return where the sensors are."""
        return f"Layout(sensors at {', '.join(map(in_words, self.positions_mm))} mm)"

    @property
    def positions_mm(self) -> Floats:
        """(sensors,) from the left end; on a plate (sensors, 2)."""
        return as_stated(self.placement.place_mm)

    @property
    def channels(self) -> dict[str, Place]:
        """Names of the sensors, with their places: s1, s2 and so on, or those of the table of the scene."""
        places, measured = self.placement.places, self.surface.scene.measured
        if measured is None:
            return {f"s{number}": place for number, place in enumerate(places, start=1)}
        names = {place: name for name, place in measured.places_mm.items()}
        return {names[place]: place for place in places}

    @cached_property
    def prior(self) -> Prior:
        """Everything that an estimator or a limit knows of the surface: physics ends here."""
        return self.surface.prior(self.positions_mm)

    @cached_property
    def world(self) -> World:
        """The simulated surface with these sensors."""
        surface = self.surface
        return World.of(surface.scene, surface.sensor, self.positions_mm, surface.readings.sensor_mm)

    def make_estimator(self, name: EstimatorName, seed: int, progress: Fraction = silent) -> Estimator:
        """Make an estimator with the effort of the aim; `progress` is called with the fraction done."""
        surface = self.surface
        return estimator_of(
            name,
            self.prior,
            min_noise_mm=surface.filter.min_noise_mm(surface.noise),
            with_force=surface.scene.wants_force,
            seed=seed,
            progress=progress,
            effort=self.aim.effort,
        )

    def limit(self, *, noise_mm: float | None = None, draws: int = 10_000, seed: int = 0) -> Measurement:
        """Return the accuracy limit in mm: the mean position error that no estimator can beat, over all contacts.

        It includes the errors of gains, zeros and mounting that the scene states, or has by default: `Surface.errors`.
        Limits with the same seed are of the same contacts.

        Parameters
        ----------
        noise_mm : standard deviation of a sample; default: that of the scene behind its filter
        draws : number of simulated contacts, at least
        seed : seed of the contacts

        Raises
        ------
        SceneError
            The noise is 0, or out of proportion to the deflection.
        """
        prior = self.prior
        if noise_mm is not None:
            stated_mm = number(noise_mm, "noise_mm")
            if stated_mm <= 0:
                raise SceneError(
                    f"noise_mm = {stated_mm:g}: must be more than 0; without noise there is no accuracy limit"
                )
            check_scale(stated_mm, self.surface.travel.largest_mm, self.surface.scene.unit)
            prior = prior.at_noise(stated_mm)
        percent = limit.accuracy_limit(prior, whole(draws, "draws", 1), whole(seed, "seed", 0))
        return percent.scaled(prior.diagonal_mm / 100)

    def error_along(self, position_mm: ArrayLike | None = None, *, draws: int = 64, seed: int = 0) -> ErrorAlong:
        """Return the accuracy limit along the beam, with all errors, as `limit`.

        Parameters
        ----------
        position_mm : (places,) of contacts, in the range of the scene, or (places, 2) on a plate; default: 41 evenly
            over a beam, 36 on a plate
        draws : number of contacts at each place, of all forces of the scene
        seed : their seed

        Raises
        ------
        SceneError
            An argument is not as its line says.
        """
        draws, prior, rng = whole(draws, "draws", 2), self.prior, np.random.default_rng(whole(seed, "seed", 0))
        extent = prior.extent
        along = as_stated(extent.grid(POSITIONS)) if position_mm is None else position_mm
        places = places_within(along, "position_mm", extent.low_mm, extent.high_mm)
        repeated = np.repeat(places, draws, axis=0)
        samples = prior.draw(repeated, rng.uniform(*prior.force_n, size=len(repeated)), rng)
        distance = limit.least_errors_mm(prior, samples).reshape(-1, draws)
        standard_error = distance.std(axis=1, ddof=1) / math.sqrt(draws)
        return ErrorAlong(as_stated(places), distance.mean(axis=1), standard_error)

    def simulate(self, position_mm: ArrayLike, force_n: ArrayLike, *, seed: int = 0) -> Floats:
        """Return samples of contacts with all errors that the scene states, or has by default.

        Parameters
        ----------
        position_mm, force_n : (contacts,) each, or one number for all; places of a plate are (contacts, 2)
        seed : seed of the errors: noise, gain, zero and mounting of each sensor are drawn anew for each contact

        Returns
        -------
        (contacts, channels) in mm, for `Model.estimate`.

        Raises
        ------
        SceneError
            A place is not on the beam, or the lengths differ.

        Examples
        --------
        >>> samples_mm = layout.simulate([60, 200, 340], 10, seed=1)
        >>> answers = model.estimate(samples_mm)
        >>> answers["position_low_mm"] < [60, 200, 340]
        array([ True,  True,  True])
        """
        size_mm = self.surface.influence.size_mm
        places = places_within(position_mm, "position_mm", np.zeros(len(size_mm)), size_mm)
        forces = numbers(force_n, "force_n", least=0.0)
        if len(forces) not in (1, len(places)):
            raise SceneError(f"force_n: give one number, or one for each of {len(places)} positions, not {len(forces)}")
        rng = np.random.default_rng(whole(seed, "seed", 0))
        return self.prior.draw(places, np.broadcast_to(forces, len(places)), rng)

    def build(
        self,
        name: str = "surface",
        *,
        estimator: EstimatorName = ESTIMATORS[0],
        seed: int = 0,
        effort: float | None = None,
    ) -> Model:
        """Build the model of these sensors, as `design-sensors build` does.

        Parameters
        ----------
        name : name of the surface
        estimator : "posterior", "small-network" or "paper-network"
        seed : seed of all random numbers; the same seed gives the same bytes
        effort : share of the usual work, from 0.01 to 100; less is quicker, and the figures have larger standard
            errors; default: that of the placement

        Raises
        ------
        SceneError
            No model can be built of the scene; the message says why.
        NotGoodEnoughError
            The model misses the accuracy limit.
        """
        # A build knows layouts, so this step forward is imported when it is taken.
        from beamtouch_models.design.building.build import build_model  # noqa: PLC0415
        from beamtouch_models.design.model import load_model  # noqa: PLC0415

        aim = self.aim if effort is None else replace(self.aim, effort=Effort(number(effort, "effort")))
        built = build_model(replace(self, aim=aim), name, estimator=estimator, seed=whole(seed, "seed", 0))
        return load_model(built.content)


def place_sensors(
    surface: Surface,
    *,
    count: int | None = None,
    seed: int = 0,
    aim: Aim = DEFAULT_AIM,
    progress: Progress = silent,
) -> Layout:
    """Check a surface and place its sensors.

    Parameters
    ----------
    surface : the surface of a scene
    count : number of sensors; None: as the scene states
    seed : seed of the search
    aim : criterion and search of the layout
    progress : called with the current step and the fraction done

    Raises
    ------
    SceneError
        No surface can be built of the scene; the message says why.
    """
    surface.check(count)
    aim = _aim_in(surface, aim)
    placement = fewest_sensors(
        surface.influence,
        surface.rules,
        (count, count) if count else surface.scene.count_range,
        wanted_mm=surface.scene.requirements.position_error_mm,
        sampling=surface.sampling,
        seed=seed,
        aim=aim,
        progress=progress,
    )
    return _checked(Layout(surface, placement, aim))


def keep_sensors(surface: Surface, positions_mm: Sequence[Place], aim: Aim = DEFAULT_AIM) -> Layout:
    """Check a surface, and take its sensors to be where they are mounted; raises as `place_sensors`.

    `aim` is that of the build that has placed them.
    """
    surface.check(len(positions_mm))
    places = in_rows(positions_mm, surface.influence.extent.axes)
    placement = Placement(places, score_layout(surface.influence, places), 0)
    return _checked(Layout(surface, placement, _aim_in(surface, aim)))


def layout_at(surface: Surface, positions_mm: ArrayLike) -> Layout:
    """Return the layout of sensors at positions that a script names; raises as `Surface.layout`."""
    scene, size_mm = surface.scene, surface.influence.size_mm
    if scene.plate is not None:
        return _layout_on_plate(surface, scene.plate, positions_mm)
    rows = places_within(positions_mm, "positions_mm", np.zeros(len(size_mm)), size_mm)
    places_mm = as_stated(rows).tolist()
    if len(places_mm) > MAX_SENSORS:
        raise SceneError(f"positions_mm: give at most {MAX_SENSORS} positions, not {len(places_mm)}")
    if twice := [place for place in places_mm if places_mm.count(place) > 1]:
        raise SceneError(f"positions_mm: it has {in_words(twice[0])} mm twice; two sensors cannot share a position")
    if away := [place for place in scene.sensors.fixed_mm if place not in places_mm]:
        raise SceneError(f"positions_mm: it lacks {away[0]:g} mm, which is in sensors.fixed_mm of the scene")
    if lacking := [place for place in map(xy_of, scene.sensors.fixed) if list(place) not in places_mm]:
        raise SceneError(f"positions_mm: it lacks {in_words(lacking[0])} mm, which is in sensors.fixed of the scene")
    if scene.measured is not None:
        measured_mm = in_rows(list(scene.measured.places_mm.values()), len(size_mm)).tolist()
        if away := [row for row in rows.tolist() if row not in measured_mm]:
            message = f"positions_mm: no sensor was measured at {in_words(away[0])} mm; choose among those of the table"
            raise SceneError(message)
        return keep_sensors(surface, places_mm)
    if len(size_mm) > 1:  # a plate of the user's own; its sensors stand as he says
        return keep_sensors(surface, places_mm)
    length_mm = float(size_mm[0])
    if conflict := next(too_close(length_mm, surface.held_mm, scene.sensors, places_mm, "positions_mm has"), ""):
        raise SceneError(conflict)
    return keep_sensors(surface, places_mm)


def _layout_on_plate(surface: Surface, plate: Plate, places_mm: ArrayLike) -> Layout:
    places = [(x, y) for x, y in places_on(places_mm, "positions_mm", plate).tolist()]
    sensors = surface.scene.sensors
    if len(places) > MAX_SENSORS:
        raise SceneError(f"positions_mm: give at most {MAX_SENSORS} places, not {len(places)}")
    if away := [place for place in map(xy_of, sensors.fixed) if place not in places]:
        raise SceneError(f"positions_mm: it lacks {in_words(away[0])} mm, which is in sensors.fixed of the scene")
    if conflict := next(too_close_on_plate(plate, sensors, places, "positions_mm has"), ""):
        raise SceneError(conflict)
    return keep_sensors(surface, places)


def _aim_in(surface: Surface, aim: Aim) -> Aim:
    """Return an aim with what the scene requires, as far as it leaves that open."""
    if aim.failed_percent is not None or aim.criterion != "position-error":
        return aim
    return replace(aim, failed_percent=surface.scene.requirements.failed_percent)


def _checked(layout: Layout) -> Layout:
    """Return a layout; SceneError if sensors may change places, or if no contact of the scene would be seen."""
    surface, prior = layout.surface, layout.prior
    surface.check_spacing(layout.placement.place_mm)
    threshold = touch_threshold(directions(shapes_at_rest(prior)), noise_at_rest(prior), surface.touch_rate)
    least = float(smallest_force_n(prior, threshold, prior.extent.grid(PLACES)).min())
    if least > prior.force_n[1]:
        raise SceneError(
            f"sensors: no contact of the scene is seen, as at least {digits(least, 3)} N is needed and contact.force_n "
            f"ends at {prior.force_n[1]:g} N; state less noise or zero_drift_mm, or allow more false_contacts_per_day"
        )
    return layout
