"""A course: what the sensors go through in time, and where the contact is, for many draws."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.challenge.surface import SimulatedSurface, Stated
from beamtouch_models.world import SensorErrors


@dataclass(frozen=True)
class Play:
    """A course for many draws at once."""

    deflection_mm: Floats
    """(draws, readings, channels), true deflection at the sensors."""
    truth_mm: Floats
    """(draws, readings), where the contact is; NaN where there is no single contact."""
    errors: SensorErrors
    rows: tuple[tuple[str, int], ...]
    """Each row of the result: its name, and the reading that it judges."""
    settled: bool = False
    """Whether the readings that are judged hold nothing but the noise that the model assumes."""
    any_force: bool = False
    """Whether the force may be anything, so that the exact posterior does not know the range of forces either."""
    quiet: bool = False
    """Whether the contacts that are judged have settled and are within the ranges of the model."""
    crosses: Bools | None = None
    """(draws,), whether the load crosses a support; None: none does. There, the beam does not bend, so that the contact
    ends and begins again."""
    fault_mm: Floats | None = None
    """(draws, channels), what sensors without noise and without honest errors measure of a fault."""
    stated: Stated | None = None
    """The user's statement on the sensors; None: they are as the model assumes."""
    lost: Bools | None = None
    """(draws, readings), which readings are lost; None: none."""
    came: float = 1.0
    """Share of the readings of a settled mean that came."""
    naming: bool = False
    """Whether the naming of a channel is scored."""
    wrong: Indices | None = None
    """(draws,), the index of the channel that is wrong; None if there is none."""
    noisy: Floats | None = None
    """(draws, channels), noise of each channel over that of the model, if that is the fault."""


Make = Callable[[SimulatedSurface, int, np.random.Generator], Play]


@dataclass(frozen=True)
class Case:
    """A course and its rows."""

    honest: bool
    """Whether it is one contact, measured as honestly as the scene states."""
    make: Make


def drawn(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return positions and forces (draws,) from the ranges of the model."""
    ranges = surface.metadata.ranges
    return rng.uniform(*ranges.position_mm, size=draws), rng.uniform(*ranges.force_n, size=draws)


def lateness(
    draws: int, readings: int, late: float, rng: np.random.Generator, judged: list[int]
) -> tuple[Floats, Bools | None]:
    """Return how late readings are, (draws, readings) in periods, and which are lost because they would be in the next.

    Parameters
    ----------
    draws, readings, rng : how many courses of how many readings, and the random numbers
    late : mean lateness in periods; 0: all readings are in time
    judged : readings that are not lost
    """
    if not late:
        return np.zeros((draws, 1)), None
    periods = rng.exponential(late, (draws, readings))
    lost = periods >= 1
    lost[:, judged] = False
    return periods % 1, lost


def settled(
    surface: SimulatedSurface,
    name: str,
    deflection_mm: Floats,
    errors: SensorErrors,
    *,
    truth_mm: Floats | None = None,
    faulty: SensorErrors | None = None,
    as_assumed: bool = False,
) -> Play:
    """Return a play in which deflections (draws, channels) stay as they are, and the last reading is judged.

    Parameters
    ----------
    surface, name : the surface, and the name of the row
    deflection_mm : (draws, channels)
    errors : of the sensors
    truth_mm : (draws,), where the contact is; None: there is no single contact
    faulty : the part of the errors that is the fault, if this is one
    as_assumed : whether a reading has the noise that the model assumes
    """
    length = surface.look_back
    still = np.repeat(deflection_mm[:, None], length, axis=1)
    nowhere = np.full(len(deflection_mm), np.nan)
    return Play(
        deflection_mm=still,
        truth_mm=np.repeat((nowhere if truth_mm is None else truth_mm)[:, None], length, axis=1),
        errors=errors,
        rows=((name, length - 1),),
        settled=as_assumed,
        fault_mm=None if faulty is None else surface.world.measured(deflection_mm[:, None], faulty)[:, 0],
    )
