"""Cases of the estimator benchmark, and the default estimator on them.

`python tests/benchmarks/estimator_cases.py` prints its error over the limit, and how many intervals hold the truth, on
every shipped scene with 2 to 6 sensors: the median and both ends, by the noise and by what is known of the force.
"""

import sys
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from beamtouch_models.design.accuracy.drawing import Draws, draw
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy import limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import ratio_of
from beamtouch_models.design.estimators.estimator import estimator_of
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.estimators.posterior.cells import resolving_cells
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.physics.influence_function import travel_of
from beamtouch_models.design.placement.placing import place
from beamtouch_models.design.scene import Scene, load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.design.sweeps import silent
from beamtouch_models.names import ESTIMATORS
from beamtouch_models.runtime.session import open_session, runner
from support.surfaces.example_scenes import SCENES
from support.surfaces.stated_problems import problem_in, real_prior

DRAWS = 8000
SEED = 11
OPEN_N = (2.0, 20.0)
"""Force of a scene that states one, where it is taken to be open."""
ROUNDS, CALLS = 60, 100
ALLOWED = 1.05
"""Largest error over the limit."""


class Case(NamedTuple):
    """A scene with so many sensors, noise in percent of the largest deflection, the force known or open."""

    scene: str
    sensors: int
    noise_percent: float
    known: bool

    def __str__(self) -> str:
        force = "known" if self.known else "open"
        return f"{self.scene}, {self.sensors} sensors, {self.noise_percent:g} %, force {force}"


def cases() -> list[Case]:
    """Every combination of three scenes, four noises, and a force that is known or open, with four sensors."""
    return [
        Case(name, 4, noise, known)
        for name in ("bench", "cantilever", "two-spans")
        for noise in (10.0, 1.0, 0.1, 0.01)
        for known in (True, False)
    ]


NOISES_PERCENT = (10.0, 1.0, 0.1, 0.01, 1e-3, 1e-4)
SENSORS = range(2, 7)


@lru_cache
def placed(name: str, sensors: int) -> tuple[Scene, tuple[float, ...]]:
    """A scene and its best layout."""
    scene, _ = load_scene(SCENES / f"{name}.toml")
    return scene, tuple(place(*problem_in(scene), sensors, SEED).place_mm[:, 0].tolist())


@lru_cache(maxsize=4)
def drawn_of(case: Case) -> tuple[Prior, Draws, Floats]:
    """Prior, contacts, and the error of the posterior's median for each."""
    scene, layout = placed(case.scene, case.sensors)
    low, high = scene.contact.force_range_n
    low, high = OPEN_N if low == high else (low, high)
    largest = travel_of(influence_of(scene)).largest_mm * high / scene.contact.force_range_n[1]
    contact = scene.contact.model_copy(update={"force_n": (high if case.known else low, high)})
    influence = influence_of(scene.model_copy(update={"contact": contact}))
    prior = Prior.of(influence, on_axis(np.array(layout)), Errors(largest * case.noise_percent / 100))
    drawn = draw(prior, DRAWS, SEED)
    return prior, drawn, np.abs(limit.posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm)


def case_row(case: Case) -> dict[str, object]:
    """The default estimator on a case."""
    prior, drawn, best = drawn_of(case)
    content = to_bytes(posterior_graph(prior, with_force=not case.known))
    reading = drawn.deflection_mm
    answers = runner(content)(reading, prior.errors.whitening(reading))
    ratio = ratio_of(np.abs(answers["position_mm"] - drawn.position_mm), best)

    def held(quantity: str, unit: str, truth: Floats) -> float:
        low, high = (answers[f"{quantity}_{end}_{unit}"] for end in ("low", "high"))
        return float(((low <= truth) & (truth <= high)).mean()) * 100

    return {
        "name": f"posterior: {case}",
        "value": ratio.value,
        "unit": "error over limit",
        "goal": "at most 1.05",
        "+-": ratio.standard_error,
        "limit, %": float(best.mean()) / prior.diagonal_mm * 100,
        "position held, %": held("position", "mm", drawn.position_mm),
        "force held, %": None if case.known else held("force", "n", drawn.force_n),
        "cells": resolving_cells(prior),
        "kB": len(content) / 1e3,
    }


def latency_rows() -> list[dict[str, object]]:
    """Time of an answer of the shipped scenes' estimators over that of a network of ten units, in turns in one run."""
    rows: list[dict[str, object]] = []
    for name in ("paper", "bench", "conveyor"):
        scene, _ = load_scene(SCENES / f"{name}.toml")
        count = scene.sensors.count_range[0]
        chosen = resolve(scene).filter
        noise = resolve(scene, chosen=chosen).noise
        prior = real_prior(scene, np.array(placed(name, count)[1]), noise.sample_mm)
        reading = draw(prior, 1, SEED).deflection_mm
        calls: dict[str, Callable[[], object]] = {}
        for estimator in ESTIMATORS:
            made = estimator_of(
                estimator,
                prior,
                min_noise_mm=chosen.min_noise_mm(noise),
                with_force=scene.wants_force,
                seed=SEED,
                progress=silent,
            )
            calls[estimator] = answer_of(to_bytes(made.graph), reading, prior.errors.whitening(reading))
        times = in_turns(calls)
        ten = times["paper-network"]
        for estimator in ESTIMATORS[:-1]:
            goal = "at most 4" if estimator == ESTIMATORS[0] else None
            rows.append(
                {
                    "name": f"{estimator}: {name}, one sample, over ten units",
                    "value": times[estimator] / ten,
                    "unit": "p50 over p50",
                    "goal": goal,
                    "us": times[estimator],
                    "ten units, us": ten,
                }
            )
    return rows


def answer_of(content: bytes, reading: Floats, whitening: Floats) -> Callable[[], object]:
    """A call that answers one sample."""
    session = open_session(content)
    feed = {"deflection_mm": reading.astype(np.float32), "whitening_per_mm": whitening.astype(np.float32)}
    return lambda: session.run(None, feed)


def in_turns(calls: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median time of each call in us, all measured in turns."""
    times: dict[str, list[int]] = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            for _ in range(CALLS):
                start = time.perf_counter_ns()
                call()
                times[name].append(time.perf_counter_ns() - start)
    return {name: float(np.median(one)) / 1e3 for name, one in times.items()}


def main() -> None:
    """Print a line for each noise and force, over scenes and numbers of sensors, and one for each case above 1.05."""
    names = sorted(path.stem for path in SCENES.glob("*.toml"))
    for known in (True, False):
        for noise in NOISES_PERCENT:
            rows = [case_row(Case(name, count, noise, known)) for name in names for count in SENSORS]
            print(f"{noise:g} %, force {'known' if known else 'open'}:", end="")
            for column in ("value", "position held, %", "force held, %"):
                found = [float(str(row[column])) for row in rows if row[column] is not None]
                if found:
                    print(f"  {column} {np.median(found):.3f} ({min(found):.3f} to {max(found):.3f})", end="")
            print(flush=True)
            for row in rows:
                if float(str(row["value"])) > ALLOWED:
                    print(f"    {row['name']}: {row['value']:.3f} +- {row['+-']:.3f}")


if __name__ == "__main__":
    main()
