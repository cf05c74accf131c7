"""The challenge: all rows of a model, scored against the truth, the goals and the best possible test.

The largest power of any test is how often one that knows the fault notices it in one settled sample.

A fault moves the whitened sample by a known vector m = W mu. What it must be told from is rest or any single contact,
F W G(x) with F >= 0, of which a force beyond the stated range costs as much as in the misfit
(`runtime.force_range`). The nearest of these is at a distance

    d = min over x and F of the root of |W (mu - F G(x))|^2 + this cost,

and a test that says "not a contact" at a rate of at most alpha also in that case can do no better than the likelihood
ratio of two normal distributions d apart (Neyman & Pearson, doi 10.1098/rsta.1933.0009):

    power = Phi(d - z_alpha),   z_alpha = Phi^-1(1 - alpha).

It is for one sample. A surface sees many, but a fault that stays adds no new direction, and its floor never averages
away.
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from scipy.special import bdtrc, chdtrc, ndtr, ndtri

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.accuracy.thresholds import left_by_contact
from beamtouch_models.design.sweeps import Progress, TaskMap, in_turn, silent
from beamtouch_models.lab.challenge.contacts import honest_cases, lossy_cases
from beamtouch_models.lab.challenge.drift import drift_cases
from beamtouch_models.lab.challenge.faults import error_cases, fault_cases
from beamtouch_models.lab.challenge.judge import Outcome, Verdicts, judge
from beamtouch_models.lab.challenge.plates import plate_cases
from beamtouch_models.lab.challenge.play import Case, DrawnContacts, SimulatedSurface
from beamtouch_models.places import as_stated, distances_mm, grid_of
from beamtouch_models.runtime.curve import Curve
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.force_range import ForceRange
from beamtouch_models.runtime.loading import ModelFile, load_bytes

MISLEADING = 0.005
"""Largest share of samples of honest contacts that may mislead."""
GHOSTS = 0.005
"""Largest share of the draws of a play in which a contact may begin more than once."""
HELD, HELD_UNSTEADY = 0.93, 0.90
"""Least share of intervals that hold the truth, without a note and with `unsteady`."""
NOTICED, LIKELY = 0.9, 0.5
"""Least share of the power that is to be noticed, where the power is above LIKELY."""
NOTED = 0.01
"""Largest share of settled contacts within the ranges that may carry a note."""
CHANCE = 0.01
"""Probability that a row which just meets a goal is said to miss it."""


@dataclass(frozen=True)
class Row:
    """The figures of one row. Shares are of all samples, unless stated otherwise; None: there are none to count."""

    name: str
    honest: bool
    quiet: bool
    """True if contacts should carry no note: settled, and within the ranges of the model."""
    samples: int
    error_mm: float | None
    """Mean distance of the place from the truth, over the samples that are a contact."""
    held: float | None
    """Share of intervals that hold the truth, of contacts without a note; along the axis where it is least."""
    plain: int
    """Number of contacts without a note."""
    held_unsteady: float | None
    """The same, of contacts whose only note is `unsteady`."""
    unsteady: int
    """Number of these."""
    held_noted: float | None
    """The same, of contacts with another note: the force is beyond the range, or too few channels for a misfit."""
    unexplained: float
    noted: float
    """Share of contacts with a note."""
    clear: float
    """Share that is said to be clear: missed, where something acts on the beam."""
    silent: float
    """Share without an answer, because too few channels work."""
    misleading: float
    """Share that is a contact without a note although there is no single contact, or although that is further from the
    place than twice the half-interval on its side, along an axis."""
    interval_mm: float | None
    """Median length of the intervals, with and without a note, along all axes."""
    ghosts: float | None = None
    """Share of `plays` in which a contact begins more than once; stated in the last row of a play."""
    plays: int = 0
    """Number of draws among which ghosts are counted: those in which no load crosses a support."""
    noticed: float | None = None
    """Share of a fault's samples that are unexplained or noted; None for honest contacts."""
    power: float | None = None
    """The same for a test that knows what happened, at the same false rate."""


def challenge(
    content: bytes, *, draws: int, seed: int, progress: Progress = silent, spread: TaskMap = in_turn
) -> list[Row]:
    """Put a model file through all cases, which are tasks for `spread`; the same seed gives the same rows.

    Raises
    ------
    ModelFileError
        The content is not a model.
    SceneError
        The scene in the model cannot be computed.
    """
    _, _, cases = _challenged(content)
    all_rows: list[Row] = []
    progress(f"case 1 of {len(cases)}", 0.0)
    for number, rows in enumerate(spread(partial(_rows, content, draws, seed), range(len(cases))), 1):
        all_rows += rows
        progress(f"case {min(number + 1, len(cases))} of {len(cases)}", number / len(cases))
    return sorted(all_rows, key=lambda row: not row.honest)


@lru_cache(maxsize=1)
def _challenged(content: bytes) -> tuple[ModelFile, SimulatedSurface, tuple[Case, ...]]:
    """Load a model and make its surface and cases, once in each process."""
    model = load_bytes(content, "the model")
    surface = SimulatedSurface.of(model.metadata)
    honest = (*honest_cases(surface), *drift_cases(surface))
    return (
        model,
        surface,
        (*honest, *error_cases(surface), *fault_cases(), *plate_cases(surface), *lossy_cases(surface)),
    )


def _rows(content: bytes, draws: int, seed: int, number: int) -> list[Row]:
    """Return the rows of the case with this number."""
    model, surface, cases = _challenged(content)
    return rows_of(model, surface, cases[number], draws, np.random.default_rng([seed, number]))


def rows_of(model: ModelFile, surface: SimulatedSurface, case: Case, draws: int, rng: np.random.Generator) -> list[Row]:
    """Play a case on the surface that a model was made for, and score its rows.

    Readings with the same name are one row. A measured structure is another one in each case, as far as its table
    leaves that open.
    """
    surface = replace(surface, world=surface.world.draw(rng))
    play = case.make(DrawnContacts.of(surface, draws, rng))
    readings = surface.world.readings(play.deflection_mm, play.errors, rng)
    first = min(reading for _, reading in play.rows) - surface.decided
    verdicts = judge(surface, model.run, readings, first, lost=play.lost)
    # The rate of false misfits of single samples is that of the test that knows what happened.
    stated = ForceRange(*surface.metadata.ranges.force_n)
    free = left_by_contact(surface.channels, stated.checked)
    alpha = float(chdtrc(free, surface.metadata.thresholds.misfit[-1]))
    rows = []
    for name in dict.fromkeys(name for name, _ in play.rows):
        scored_readings = [reading for row_name, reading in play.rows if row_name == name]
        truth = play.truth_mm[:, scored_readings].reshape(-1, surface.extent.axes)
        part = verdicts.at(scored_readings)
        row = scored(name, part, truth, honest=case.honest, quiet=play.quiet)
        if not case.honest and play.fault_mm is not None:
            row = replace(row, power=power_of_shift(distances(surface, play.fault_mm, part.valid), alpha))
        rows.append(row)
    if play.again:
        return rows
    felt = verdicts.outcome if play.crosses is None else verdicts.outcome[~play.crosses]
    return [*rows[:-1], replace(rows[-1], ghosts=ghosts(felt) if len(felt) else None, plays=len(felt))]


def scored(name: str, verdicts: Verdicts, truth_mm: Floats, *, honest: bool, quiet: bool = False) -> Row:
    """Return the row of some samples.

    Parameters
    ----------
    name, honest, quiet : name and group of the row
    verdicts : the statements on the samples (samples,)
    truth_mm : (samples, axes) places of the contacts; NaN where there is no single contact
    """
    single = ~np.isnan(truth_mm).any(axis=1)
    contact = verdicts.outcome == Outcome.CONTACT
    noted = contact & (verdicts.unsteady | verdicts.other_note)
    plain, unsteady = contact & ~noted, contact & verdicts.unsteady & ~verdicts.other_note
    inside = (verdicts.low_mm <= truth_mm) & (truth_mm <= verdicts.high_mm)  # False for NaN
    unexplained = float((verdicts.outcome == Outcome.UNEXPLAINED).mean())
    error = distances_mm(verdicts.place_mm - truth_mm)[contact & single]
    length = verdicts.high_mm - verdicts.low_mm
    noticed = None if honest else unexplained + float(noted.mean())
    return Row(
        name=name,
        honest=honest,
        quiet=quiet,
        samples=len(contact),
        error_mm=float(error.mean()) if len(error) else None,
        held=_share(inside, plain & single),
        plain=int(plain.sum()),
        held_unsteady=_share(inside, unsteady & single),
        unsteady=int(unsteady.sum()),
        held_noted=_share(inside, verdicts.other_note & contact & single),
        unexplained=unexplained,
        noted=float(noted.mean()),
        clear=float((verdicts.outcome == Outcome.CLEAR).mean()),
        silent=float((verdicts.outcome == Outcome.NOTHING).mean()),
        misleading=float((plain & _misleads(verdicts, truth_mm)).mean()),
        interval_mm=float(np.median(length[contact])) if contact.any() else None,
        noticed=noticed,
    )


def ghosts(verdicts: Indices) -> float:
    """Return the share of draws, (draws, readings) of `Outcome`, in which a contact begins more than once.

    A stretch that is unexplained, or without an answer, does not end a contact.
    """
    decided = (verdicts == Outcome.CLEAR) | (verdicts == Outcome.CONTACT)
    last = np.maximum.accumulate(np.where(decided, np.arange(verdicts.shape[1]), 0), axis=1)
    contact = np.take_along_axis(verdicts, last, axis=1) == Outcome.CONTACT
    begins = contact[:, 1:] & ~contact[:, :-1]
    return float((contact[:, 0] + begins.sum(axis=1) > 1).mean())


def _misleads(verdicts: Verdicts, truth_mm: Floats) -> Bools:
    """Return whether the truth is further from the place than twice the half-interval on its side, or nowhere.

    On a plate, along either axis.
    """
    above = truth_mm > verdicts.place_mm
    half = np.where(above, verdicts.high_mm - verdicts.place_mm, verdicts.place_mm - verdicts.low_mm)
    near = np.abs(truth_mm - verdicts.place_mm) <= 2 * half
    return np.asarray(~near.all(axis=-1), dtype=np.bool_)


def _share(happened: Bools, among: Bools) -> float | None:
    """Return the share among some samples of what happened (samples, axes), along the axis where it is least."""
    return float(happened[among].mean(axis=0).min()) if among.any() else None


def misses(row: Row) -> list[str]:
    """Return the goals that a row misses by more than chance explains, each in a few words."""
    missed = []
    if row.honest:
        if _exceeds(row.misleading, row.samples, MISLEADING):
            missed.append(f"misleading {row.misleading:.1%}")
        if row.ghosts is not None and _exceeds(row.ghosts, row.plays, GHOSTS):
            missed.append(f"ghosts {row.ghosts:.1%}")
        for share, number, goal, when in (
            (row.held, row.plain, HELD, ""),
            (row.held_unsteady, row.unsteady, HELD_UNSTEADY, " when unsteady"),
        ):
            if share is not None and _exceeds(1 - share, number, 1 - goal):
                missed.append(f"held {share:.0%}{when}")
        if row.quiet and _exceeds(row.noted, row.samples, NOTED):
            missed.append(f"noted {row.noted:.1%}")
        return missed
    power, noticed = row.power or 0.0, row.noticed or 0.0
    if power > LIKELY and _exceeds(1 - noticed, row.samples, 1 - NOTICED * power):
        missed.append(f"noticed {noticed:.0%} of {power:.0%}")
    return missed


def _exceeds(share: float, number: int, goal: float) -> bool:
    """Return whether a share is above its goal by more than chance explains."""
    count = round(share * number)
    return count > 0 and bool(bdtrc(count - 1, number, goal) < CHANCE)


PLACES = 1001
"""Places of the contacts with which a fault is compared first."""


def distances(surface: SimulatedSurface, fault_mm: Floats, valid: Bools) -> Floats:
    """Return how far faults (draws, channels) are from rest and from every contact, in deviations; (draws,).

    `valid` (draws, channels) says which channels take part.
    """
    departures, floor = surface.world.departures, surface.metadata.floor
    ticks = surface.extent.ticks(PLACES)
    # The deflections that the model expects of contacts, without offsets and the curvature of a calibration.
    curve = Curve(tuple(ticks), surface.world.influence(as_stated(grid_of(ticks))) * np.array(departures.gain))
    errors = Errors(surface.min_noise_mm, np.array(floor.gain), np.array(floor.zero_mm))
    weight = np.where(valid, 1 / errors.variance_mm2(fault_mm), 0.0)
    stated = ForceRange(*surface.metadata.ranges.force_n)
    return np.sqrt(curve.unexplained(np.where(valid, departures.linear_mm(fault_mm), 0.0), weight, stated))


def power_of_shift(distance: Floats, alpha: float) -> float:
    """Return the mean power of the test that knows what happened, for faults (draws,) at a distance."""
    return float(ndtr(distance + ndtri(alpha)).mean())
