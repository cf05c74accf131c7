"""A play: what the sensors of a simulated surface go through in time, and where the contact is, for many draws."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.pricing.walk import walk_of
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.design.world import SensorErrors, World
from beamtouch_models.filters import Walk
from beamtouch_models.places import Extent, as_stated
from beamtouch_models.runtime.metadata import Metadata

SPARE = 8
"""Extra readings that let the decision settle after the filter."""


@dataclass(frozen=True)
class SimulatedSurface:
    """The surface that is challenged: the world of a model's scene as calibrated, and what the model states of it."""

    metadata: Metadata
    scene: Scene
    world: World
    slowest_period: float
    """In readings; 0 if it is not known."""
    unseen_swing: float
    """Swing of the beam that readings do not show, over that which they show."""
    gain: Floats
    """(channels,) standard deviation of the relative gain error."""
    zero_mm: Floats
    """(channels,) standard deviation of the zero."""
    walk: Walk | None = None
    """The drift of the zeros; None if they do not drift."""

    @classmethod
    def of(cls, metadata: Metadata) -> Self:
        """Return the surface that a model was made for, with all effects that its scene states.

        Raises
        ------
        SceneError
            The scene in the model cannot be computed.
        """
        surface, channels = resolve_model(metadata), len(metadata.layout)
        gain, zero_mm = (np.full(channels, value) for value in (surface.readings.gain, surface.readings.floor_mm))
        if metadata.calibration is not None:
            gain, zero_mm = np.array(metadata.floor.gain), np.array(metadata.floor.zero_mm)
        # The noise that a model states of a reading holds the steps of the ADC.
        steps_mm2 = metadata.sensor.gain_mm_per_count**2 / 12
        noise_mm = float(np.sqrt(max(0.0, metadata.noise.reading_mm**2 - steps_mm2)))
        world = World.of(surface.scene, metadata.sensor, metadata.layout_mm, noise_mm, metadata.departures)
        seen, walk = (surface.slowest_period, surface.unseen_swing), walk_of(metadata, surface.readings)
        return cls(metadata, surface.scene, world, *seen, gain, zero_mm, walk)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.world.channels

    @property
    def extent(self) -> Extent:
        """The places of contacts."""
        return self.metadata.extent

    def under(self, place_mm: Floats, force_n: Floats) -> Floats:
        """Return deflections at rest (..., channels) in mm under contacts at places (..., axes) with forces (...)."""
        return self.world.under(as_stated(place_mm), force_n)

    @property
    def min_noise_mm(self) -> float:
        """Noise of a settled sample."""
        return self.metadata.filter.min_noise_mm(self.metadata.noise)

    @property
    def look_back(self) -> int:
        """Number of readings after which nothing before them is in a sample or in the state of the surface."""
        return self.metadata.filter.max_readings + self.decided

    @property
    def decided(self) -> int:
        """Number of readings after which the state of the surface has followed a settled filter."""
        return 2 * self.metadata.filter.window + int(np.ceil(self.slowest_period)) + SPARE

    def honest(self, draws: int, rng: np.random.Generator) -> SensorErrors:
        """Return errors as large as the scene states, or as the calibration left."""
        shape = (draws, self.channels)
        gain, zero_mm = 1 + rng.normal(size=shape) * self.gain, rng.normal(size=shape) * self.zero_mm
        return replace(SensorErrors.none(*shape), gain=gain, zero_mm=zero_mm)


@dataclass(frozen=True)
class Play:
    """A play for many draws at once."""

    deflection_mm: Floats
    """(draws, readings, channels), true deflection at the sensors."""
    truth_mm: Floats
    """(draws, readings, axes), where the contact is; NaN where there is no single contact."""
    errors: SensorErrors
    rows: tuple[tuple[str, int], ...]
    """Each row of the result: its name, and the reading that it judges."""
    quiet: bool = False
    """True if the contacts that are judged have settled and are within the ranges of the model."""
    crosses: Bools | None = None
    """(draws,), whether the load crosses a support; None: none does. There, the beam does not bend, so that the contact
    ends and begins again."""
    again: bool = False
    """True if a contact may begin more than once."""
    fault_mm: Floats | None = None
    """(draws, channels), what sensors without noise and without honest errors measure of a fault."""
    lost: Bools | None = None
    """(draws, readings), which readings are lost; None: none."""


@dataclass(frozen=True)
class DrawnContacts:
    """Contacts on a surface, drawn from the ranges of its model, and its sensors with the errors that it states."""

    surface: SimulatedSurface
    draws: int
    rng: np.random.Generator
    """For whatever else a play draws."""
    place_mm: Floats
    """(draws, axes)"""
    force_n: Floats
    """(draws,)"""
    honest: SensorErrors
    """Errors as large as the scene states, or as the calibration left."""

    @classmethod
    def of(cls, surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Self:
        """Draw contacts and errors."""
        place_mm = surface.extent.uniform(draws, rng)
        force_n = rng.uniform(*surface.metadata.ranges.force_n, size=draws)
        return cls(surface, draws, rng, place_mm, force_n, surface.honest(draws, rng))

    def directions(self) -> Floats:
        """Return a direction for each draw, (draws, axes): along a beam, or anywhere into the first quarter of a plate.

        Mirrored along each axis, these are all directions.
        """
        if self.surface.extent.axes == 1:
            return np.ones((self.draws, 1))
        angle = self.rng.uniform(0, np.pi / 2, size=self.draws)
        return np.column_stack([np.cos(angle), np.sin(angle)])

    @property
    def perfect(self) -> SensorErrors:
        """Sensors without errors."""
        return SensorErrors.none(self.draws, self.surface.channels)

    @cached_property
    def deflection_mm(self) -> Floats:
        """(draws, channels) at rest under the contacts."""
        return self.surface.under(self.place_mm, self.force_n)

    def where(self, there: Bools, other_mm: Floats | float = np.nan) -> Floats:
        """Return the places of the contacts (draws, readings, axes) where they are `there` (draws, readings).

        Elsewhere it is `other_mm`; NaN: there is no single contact.
        """
        return np.where(there[..., None], self.place_mm[:, None], other_mm)

    @cached_property
    def one(self) -> Floats:
        """(draws, channels), 1 for one channel of each draw, any of them, and 0 for the others."""
        channels = self.surface.channels
        return np.eye(channels)[self.rng.integers(channels, size=self.draws)]

    def settle(
        self,
        name: str,
        deflection_mm: Floats | None = None,
        errors: SensorErrors | None = None,
        *,
        truth_mm: Floats | None = None,
        fault: SensorErrors | None = None,
    ) -> Play:
        """Return a play in which deflections (draws, channels) stay as they are, and the last reading is judged.

        Parameters
        ----------
        name : of the row
        deflection_mm, errors, truth_mm : those of the contacts and of honest sensors, unless given
        fault : the part of the errors that is the fault, if this is one
        """
        clean = self.deflection_mm if deflection_mm is None else deflection_mm
        truth, length = self.place_mm if truth_mm is None else truth_mm, self.surface.look_back
        return Play(
            deflection_mm=np.repeat(clean[:, None], length, axis=1),
            truth_mm=np.repeat(truth[:, None], length, axis=1),
            errors=errors or self.honest,
            rows=((name, length - 1),),
            fault_mm=None if fault is None else self.surface.world.measured(clean[:, None], fault)[:, 0],
        )


Make = Callable[[DrawnContacts], Play]


class Case(NamedTuple):
    """A play and its rows."""

    honest: bool
    """True if it is one contact, measured as honestly as the scene states."""
    make: Make
