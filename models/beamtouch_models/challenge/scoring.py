"""Scores of a model's statements on samples, against the truth, and of the channels that it names."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from beamtouch_models.accuracy.forces import MAX_FORCE_RATIO, TAIL
from beamtouch_models.accuracy.posterior import posterior_quantiles
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.challenge.judge import NOBODY, Judged, Said, judge
from beamtouch_models.challenge.play import Play
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.decision.suspects import SAMPLES
from beamtouch_models.session import Run

DRAWS = 25
"""Number of draws that are followed; each unexplained sample of them is asked about without each of its channels."""


class Naming(NamedTuple):
    """How often a channel is named, as shares of the samples that are unexplained; None if there are none."""

    named: float | None
    """The channel that is wrong."""
    misnamed: float | None
    """A channel that is not wrong."""
    samples: int
    """Number of samples that are unexplained."""


def naming(surface: SimulatedSurface, run: Run, play: Play, rng: np.random.Generator) -> Naming:
    """Return which channel is named when the last reading of a play has lasted for as long as suspects are sought."""
    deflection_mm = np.repeat(play.deflection_mm[:DRAWS, -1:], surface.look_back + SAMPLES, axis=1)
    errors = play.errors
    some = replace(
        errors,
        gain=errors.gain[:DRAWS],
        zero_mm=errors.zero_mm[:DRAWS],
        noise=errors.noise[:DRAWS],
        missing=errors.missing[:DRAWS],
    )
    said = judge(surface, run, surface.world.readings(deflection_mm, some, rng), naming=True).at([-1])
    wrong = np.full(len(said.said), NOBODY) if play.wrong is None else play.wrong[:DRAWS]
    there = said.said == Said.UNEXPLAINED
    if not there.any():
        return Naming(None, None, 0)
    anyone = said.suspect != NOBODY
    right = anyone & (said.suspect == wrong)
    return Naming(float(right[there].mean()), float((anyone & ~right)[there].mean()), int(there.sum()))


LOW, HIGH = 0.025, 0.975
"""Quantiles at the ends of an interval."""


@dataclass(frozen=True)
class Row:
    """The figures of one row. Shares are of all samples, unless stated otherwise; None: there are none to count."""

    name: str
    honest: bool
    quiet: bool
    """Whether contacts should carry no note: settled, and within the ranges of the model."""
    samples: int
    error_mm: float | None
    """Mean distance of the position from the truth, over the samples that are a contact."""
    held: float | None
    """Share of intervals that hold the truth, of contacts without a note."""
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
    position than twice the half-interval on its side."""
    interval_mm: float | None
    """Median length of the intervals, with and without a note."""
    width: float | None
    """Median interval of contacts that are not `unsteady`, over that of the exact posterior under the true errors."""
    ghosts: float | None = None
    """Share of all draws in which a contact begins more than once; stated in the last row of a course."""
    noticed: float | None = None
    """Share of a fault's samples that are unexplained or noted; None for honest contacts."""
    power: float | None = None
    """The same for a test that knows what happened, at the same false rate."""
    naming: Naming | None = None
    """Shares of samples that name a channel, where that is scored."""


def scored(
    name: str, said: Judged, truth_mm: Floats, *, honest: bool, quiet: bool = False, exact_mm: Floats | None = None
) -> Row:
    """Return the row of some samples.

    Parameters
    ----------
    name, honest, quiet : name and group of the row
    said : the statements on the samples (samples,)
    truth_mm : (samples,) positions of the contacts; NaN where there is no single contact
    exact_mm : (samples,) lengths of the intervals of the exact posterior; None if there is none
    """
    single = ~np.isnan(truth_mm)
    contact = said.said == Said.CONTACT
    noted = contact & (said.unsteady | said.other_note)
    plain, unsteady = contact & ~noted, contact & said.unsteady & ~said.other_note
    inside = (said.low_mm <= truth_mm) & (truth_mm <= said.high_mm)  # False for NaN
    unexplained = float((said.said == Said.UNEXPLAINED).mean())
    error = np.abs(said.position_mm - truth_mm)[contact & single]
    length = said.high_mm - said.low_mm
    steady = contact & ~said.unsteady
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
        held_noted=_share(inside, said.other_note & contact & single),
        unexplained=unexplained,
        noted=float(noted.mean()),
        clear=float((said.said == Said.CLEAR).mean()),
        silent=float((said.said == Said.NOTHING).mean()),
        misleading=float((plain & _misleads(said, truth_mm)).mean()),
        interval_mm=float(np.median(length[contact])) if contact.any() else None,
        width=None if exact_mm is None or not steady.any() else float(np.median((length / exact_mm)[steady])),
        noticed=noticed,
    )


def ghosts(said: Indices) -> float:
    """Return the share of draws, (draws, readings) of `Said`, in which a contact begins more than once.

    A stretch that is unexplained, or without an answer, does not end a contact.
    """
    decided = (said == Said.CLEAR) | (said == Said.CONTACT)
    last = np.maximum.accumulate(np.where(decided, np.arange(said.shape[1]), 0), axis=1)
    contact = np.take_along_axis(said, last, axis=1) == Said.CONTACT
    begins = contact[:, 1:] & ~contact[:, :-1]
    return float((contact[:, 0] + begins.sum(axis=1) > 1).mean())


def _misleads(said: Judged, truth_mm: Floats) -> Bools:
    """Return whether the truth is further from the position than twice the half-interval on its side, or nowhere."""
    above = truth_mm > said.position_mm
    half = np.where(above, said.high_mm - said.position_mm, said.position_mm - said.low_mm)
    far: Bools = ~(np.abs(truth_mm - said.position_mm) <= 2 * half)
    return far


def _share(happened: Bools, among: Bools) -> float | None:
    return float(happened[among].mean()) if among.any() else None


def exact_intervals_mm(prior: Prior, said: Judged, *, any_force: bool = False) -> Floats:
    """Return the lengths (samples,) of the exact intervals of settled samples; NaN where too few channels work.

    Without a known range, the prior of the force is even, up to the largest force that an estimator considers.
    """
    tail = 0.0 if any_force else TAIL
    if any_force:
        prior = replace(prior, force_n=(0.0, MAX_FORCE_RATIO * prior.force_n[1]))
    found = np.full(len(said.said), math.nan)
    answered = np.flatnonzero(said.said != Said.NOTHING)
    if not len(answered):
        return found
    samples, valid = said.mean_mm[answered], said.valid[answered]
    levels = np.tile([LOW, HIGH], (len(samples), 1))
    whitening = prior.whitening(samples, valid)
    quantiles = posterior_quantiles(prior, samples, levels, whitening_per_mm=whitening, tail=tail)[0]
    found[answered] = quantiles[:, 1] - quantiles[:, 0]
    return found
