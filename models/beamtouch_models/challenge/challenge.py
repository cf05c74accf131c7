"""The challenge: all rows of a model, and which of them miss the goals."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import bdtrc, chdtrc

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.thresholds import left_by_contact
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.challenge.contacts import honest_cases, lossy_cases
from beamtouch_models.challenge.faults import fault_cases
from beamtouch_models.challenge.judge import judge
from beamtouch_models.challenge.play import Case, Play
from beamtouch_models.challenge.power import distances, power_of_noise, power_of_shift
from beamtouch_models.challenge.scoring import Row, exact_intervals_mm, ghosts, naming, scored
from beamtouch_models.challenge.sensor_cases import error_cases
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.loading import ModelFile, load_bytes
from beamtouch_models.progress import Progress, silent
from beamtouch_models.surface import prior_of_model
from beamtouch_models.sweeps import Spread, in_turn

MISLEADING = 0.005
"""Largest share of samples of honest contacts that may mislead."""
GHOSTS = 0.005
"""Largest share of courses in which a contact may begin more than once."""
HELD, HELD_UNSTEADY = 0.93, 0.90
"""Least share of intervals that hold the truth, without a note and with `unsteady`."""
NOTICED, LIKELY = 0.9, 0.5
"""Least share of the power that is to be noticed, where the power is above LIKELY."""
NOTED = 0.01
"""Largest share of settled contacts within the ranges that may carry a note."""
MISNAMED = 0.02
"""Largest share of unexplained samples of a fault that may name a channel that is not wrong."""
CHANCE = 0.01
"""Probability that a row which just meets a goal is said to miss it."""
WIDTH = 1.1
"""Largest median interval over that of the exact posterior."""


@dataclass(frozen=True)
class _Courses:
    """All courses of a case, as a task that can be sent."""

    content: bytes
    """The model file."""
    number: int
    """Number of the case."""
    draws: int
    seed: int


def challenge(
    content: bytes, *, draws: int, seed: int, progress: Progress = silent, spread: Spread = in_turn
) -> list[Row]:
    """Put a model file through all cases, which are tasks for `spread`; the same seed gives the same rows.

    Raises
    ------
    ModelFileError
        The content is not a model.
    SceneError
        The scene in the model cannot be computed.
    """
    number_of_cases = len(_challenged(content).cases)
    tasks = [_Courses(content, number, draws, seed) for number in range(number_of_cases)]
    found: list[Row] = []
    progress(f"case 1 of {len(tasks)}", 0.0)
    for number, rows in enumerate(spread(_rows, tasks), 1):
        found += rows
        progress(f"case {min(number + 1, len(tasks))} of {len(tasks)}", number / len(tasks))
    return sorted(found, key=lambda row: not row.honest)


@dataclass(frozen=True)
class _Challenged:
    """A model, with its surface, prior and cases."""

    model: ModelFile
    surface: SimulatedSurface
    prior: Prior | None
    cases: tuple[Case, ...]


@lru_cache(maxsize=1)
def _challenged(content: bytes) -> _Challenged:
    """Load a model and make its cases, once in each process."""
    model = load_bytes(content, "the model")
    surface = SimulatedSurface.of(model.metadata)
    prior = None if model.metadata.calibration else prior_of_model(model.metadata)
    if prior is not None:
        # What has settled is the mean of as many readings as the filter takes. The simulated sensors stand in place.
        noise_mm = model.metadata.noise.reading_mm / math.sqrt(model.metadata.filter.max_readings)
        prior = replace(prior, noise_mm=noise_mm, uncertain_at=None)
    cases = (*honest_cases(surface), *error_cases(surface), *fault_cases(), *lossy_cases(surface))
    return _Challenged(model, surface, prior, cases)


def _rows(task: _Courses) -> list[Row]:
    at = _challenged(task.content)
    rng = np.random.default_rng([task.seed, task.number])
    return rows_of(at.model, at.surface, at.prior, at.cases[task.number], task.draws, rng)


def rows_of(
    model: ModelFile, surface: SimulatedSurface, prior: Prior | None, case: Case, draws: int, rng: np.random.Generator
) -> list[Row]:
    """Play a case and score its rows; readings with the same name are one row.

    Parameters
    ----------
    model, surface : the model and the surface that it was made for
    prior : of the model, for the exact posterior; None: that is left out
    case, draws, rng : the case, how often it is drawn, and the random numbers
    """
    play = case.make(surface, draws, rng)
    readings = surface.world.readings(play.deflection_mm, play.errors, rng)
    first = max(0, min(reading for _, reading in play.rows) - surface.decided)
    if prior is not None:
        prior = replace(prior, noise_mm=prior.noise_mm / math.sqrt(play.came))
    stating = surface.stating(play.stated) if play.stated else surface
    said = judge(stating, model.run, readings, first, lost=play.lost)
    found = []
    for name in dict.fromkeys(name for name, _ in play.rows):
        at = [reading for other, reading in play.rows if other == name]
        part, truth = said.at(at), play.truth_mm[:, at].ravel()
        exact = (
            exact_intervals_mm(prior, part, any_force=play.any_force)
            if prior and case.honest and play.settled
            else None
        )
        row = scored(name, part, truth, honest=case.honest, quiet=play.quiet, exact_mm=exact)
        if not case.honest and play.fault_mm is not None:
            row = replace(row, power=_power(surface, play, play.fault_mm, part.valid))
        if play.naming:
            row = replace(row, naming=naming(surface, model.run, play, rng))
        found.append(row)
    felt = said.said if play.crosses is None else said.said[~play.crosses]
    return [*found[:-1], replace(found[-1], ghosts=ghosts(felt) if len(felt) else None)]


def _power(surface: SimulatedSurface, play: Play, fault_mm: Floats, valid: Bools) -> float:
    """Return the power of the test that knows what happened, at the rate of false misfits of single samples."""
    alpha = float(chdtrc(left_by_contact(surface.channels), surface.metadata.thresholds.misfit[-1]))
    if play.noisy is not None:
        return power_of_noise(surface, fault_mm, play.noisy, alpha)
    return power_of_shift(distances(surface, fault_mm, valid), alpha)


def misses(row: Row) -> list[str]:
    """Return the goals that a row misses by more than chance explains, each in a few words."""
    found = []
    if row.honest:
        if _exceeds(row.misleading, row.samples, MISLEADING):
            found.append(f"misleading {row.misleading:.1%}")
        if row.ghosts is not None and _exceeds(row.ghosts, row.samples, GHOSTS):
            found.append(f"ghosts {row.ghosts:.1%}")
        for share, number, goal, when in (
            (row.held, row.plain, HELD, ""),
            (row.held_unsteady, row.unsteady, HELD_UNSTEADY, " when unsteady"),
        ):
            if share is not None and _exceeds(1 - share, number, 1 - goal):
                found.append(f"held {share:.0%}{when}")
        if row.width is not None and row.width > WIDTH:
            found.append(f"interval {row.width:.2f} of the exact one")
        if row.quiet and _exceeds(row.noted, row.samples, NOTED):
            found.append(f"noted {row.noted:.1%}")
        return found
    power, noticed = row.power or 0.0, row.noticed or 0.0
    if power > LIKELY and _exceeds(1 - noticed, row.samples, 1 - NOTICED * power):
        found.append(f"noticed {noticed:.0%} of {power:.0%}")
    if row.naming and row.naming.misnamed and _exceeds(row.naming.misnamed, row.naming.samples, MISNAMED):
        found.append(f"another channel named {row.naming.misnamed:.0%}")
    return found


def _exceeds(share: float, number: int, goal: float) -> bool:
    """Return whether a share is above its goal by more than chance explains."""
    count = round(share * number)
    return count > 0 and bool(bdtrc(count - 1, number, goal) < CHANCE)
