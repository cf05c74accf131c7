"""The challenge: all rows of a model."""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from scipy.special import chdtrc

from beamtouch_models.accuracy.thresholds import left_by_contact
from beamtouch_models.challenge.contacts import honest_cases, lossy_cases
from beamtouch_models.challenge.faults import error_cases, fault_cases
from beamtouch_models.challenge.judge import judge
from beamtouch_models.challenge.play import Case, Drawn, SimulatedSurface
from beamtouch_models.challenge.scoring import Row, distances, ghosts, power_of_shift, scored
from beamtouch_models.loading import ModelFile, load_bytes
from beamtouch_models.progress import Progress, silent
from beamtouch_models.sweeps import Spread, in_turn


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
    _, _, cases = _challenged(content)
    found: list[Row] = []
    progress(f"case 1 of {len(cases)}", 0.0)
    for number, rows in enumerate(spread(partial(_rows, content, draws, seed), range(len(cases))), 1):
        found += rows
        progress(f"case {min(number + 1, len(cases))} of {len(cases)}", number / len(cases))
    return sorted(found, key=lambda row: not row.honest)


@lru_cache(maxsize=1)
def _challenged(content: bytes) -> tuple[ModelFile, SimulatedSurface, tuple[Case, ...]]:
    """Load a model and make its surface and cases, once in each process."""
    model = load_bytes(content, "the model")
    surface = SimulatedSurface.of(model.metadata)
    return model, surface, (*honest_cases(surface), *error_cases(surface), *fault_cases(), *lossy_cases(surface))


def _rows(content: bytes, draws: int, seed: int, number: int) -> list[Row]:
    """Return the rows of the case with this number."""
    model, surface, cases = _challenged(content)
    return rows_of(model, surface, cases[number], draws, np.random.default_rng([seed, number]))


def rows_of(model: ModelFile, surface: SimulatedSurface, case: Case, draws: int, rng: np.random.Generator) -> list[Row]:
    """Play a case on the surface that a model was made for, and score its rows.

    Readings with the same name are one row.
    """
    play = case.make(Drawn.of(surface, draws, rng))
    readings = surface.world.readings(play.deflection_mm, play.errors, rng)
    first = max(0, min(reading for _, reading in play.rows) - surface.decided)
    said = judge(surface, model.run, readings, first, lost=play.lost)
    # The rate of false misfits of single samples is that of the test that knows what happened.
    alpha = float(chdtrc(left_by_contact(surface.channels), surface.metadata.thresholds.misfit[-1]))
    found = []
    for name in dict.fromkeys(name for name, _ in play.rows):
        at = [reading for other, reading in play.rows if other == name]
        part, truth = said.at(at), play.truth_mm[:, at].ravel()
        row = scored(name, part, truth, honest=case.honest, quiet=play.quiet)
        if not case.honest and play.fault_mm is not None:
            row = replace(row, power=power_of_shift(distances(surface, play.fault_mm, part.valid), alpha))
        found.append(row)
    felt = said.said if play.crosses is None else said.said[~play.crosses]
    return [*found[:-1], replace(found[-1], ghosts=ghosts(felt) if len(felt) else None)]
