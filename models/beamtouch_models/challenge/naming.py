"""Score of `check-NAME`: how often it names the faulty channel, once a fault has been unexplained for long."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from beamtouch_models.challenge.judge import NOBODY, Said, judge
from beamtouch_models.challenge.play import Play
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.decision import SAMPLES
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
    said = judge(surface, run, surface.readings(deflection_mm, some, rng), naming=True).at([-1])
    wrong = np.full(len(said.said), NOBODY) if play.wrong is None else play.wrong[:DRAWS]
    there = said.said == Said.UNEXPLAINED
    if not there.any():
        return Naming(None, None, 0)
    anyone = said.suspect != NOBODY
    right = anyone & (said.suspect == wrong)
    return Naming(float(right[there].mean()), float((anyone & ~right)[there].mean()), int(there.sum()))
