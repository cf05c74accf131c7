"""Intervals by the place and by the force of a contact: how many hold, and how wide they are beside the best.

`python tests/benchmarks/intervals_along.py bench paper` builds these scenes, or takes the model files that are named in
their place, and prints a table of stretches of 5 % of the beam, and one of fifths of the force. `--calibrated 8` does
it for all contacts on so many real surfaces, each behind a model that ten loads have fitted. The best knows the
surface, and that the force is within its range: the central 95 % of a posterior that shares no code with ours, on the
same contacts.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import log_ndtr

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share

from shipped import build

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.calibration.calibrate import calibrate
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.sweeps import silent
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.places import on_axis
from beamtouch_models.runtime import ModelFile, load, load_bytes
from support.surfaces.real_surfaces import random_imperfections, recorded, true_prior

SCENE_NAMES = ("bench", "paper", "two-spans", "cantilever", "wide-contact")
STRETCHES, FORCES = 20, 5
COARSE, FINE, TABLE = 800, 600, 50_001
"""Places of both grids of a posterior, and of the table from which they take the influence."""
ROUGH = 0.1
"""Effort of a calibration."""
LAST_MM = 1.6


@dataclass(frozen=True)
class Contacts:
    """Contacts that are seen, and what is said of them; all (contacts,)."""

    place_mm: Floats
    force_n: Floats
    low_mm: Floats
    high_mm: Floats
    best_mm: Floats
    """Width of the best interval."""
    best_holds: Bools


def log_density(sample: Floats, deviation: Floats, influence: Floats, force_n: tuple[float, float]) -> Floats:
    """The log density at places (places, channels) of a sample whose force is even over a range."""
    shape, seen = influence / deviation, sample / deviation
    if force_n[0] == force_n[1]:
        return np.asarray(-((seen - force_n[0] * shape) ** 2).sum(axis=1) / 2)
    size = np.sqrt((shape**2).sum(axis=1)) + 1e-12
    along = shape @ seen / size
    across = ((seen - (along / size)[:, None] * shape) ** 2).sum(axis=1)
    ends = [force * size - along for force in force_n]
    mirrored = ends[0] + ends[1] > 0
    upper, lower = np.where(mirrored, -ends[0], ends[1]), np.where(mirrored, -ends[1], ends[0])
    share = log_ndtr(upper) + np.log1p(-np.exp(np.minimum(log_ndtr(lower) - log_ndtr(upper), -1e-300)))
    return np.asarray(share - across / 2 - np.log(size))


def best_interval(
    sample: Floats, deviation: Floats, table: tuple[Floats, Floats], force_n: tuple[float, float]
) -> Floats:
    """The central 95 % of the posterior, by the trapezoidal rule on a grid where it is likely."""

    def influence_at(place_mm: Floats) -> Floats:
        node = (place_mm - table[0][0]) / (table[0][1] - table[0][0])
        below = np.clip(node.astype(int), 0, TABLE - 2)
        part = (node - below)[:, None]
        return np.asarray((1 - part) * table[1][below] + part * table[1][below + 1])

    grid = np.linspace(table[0][0], table[0][-1], COARSE)
    for _ in range(3):
        height = log_density(sample, deviation, influence_at(grid), force_n)
        around = np.pad(height, 1, mode="edge")
        peak = height + np.maximum(height - np.minimum(around[:-2], around[2:]), 0.0) / 2
        near = np.convolve(peak > height.max() - 25, np.ones(5), "same") > 0
        cells = near[1:] | near[:-1]
        along = np.append(0.0, np.cumsum(np.diff(grid) * cells))
        finer = np.unique(np.interp(np.linspace(0.0, along[-1], FINE), along, grid))
        if cells.mean() > 0.4:
            break
        grid = finer
    height = log_density(sample, deviation, influence_at(grid), force_n)
    density = np.exp(height - height.max())
    below = np.append(0.0, np.cumsum(np.diff(grid) * (density[1:] + density[:-1])))
    return np.interp([0.025, 0.975], below / below[-1], grid)


def said_of(model: ModelFile, real: Prior, place_mm: Floats, force_n: Floats, seed: int) -> Contacts:
    """Return what a model says of contacts on a surface that it may know only nearly."""
    sample = real.draw(on_axis(place_mm), force_n, np.random.default_rng(seed))
    answers = model.answer(real.measured(sample), real.errors.noise_mm)
    places = np.linspace(*real.extent.range_mm, TABLE)
    table, deviation = (places, real.influence_at(on_axis(places))), real.errors.deviation_mm(sample)
    seen = np.flatnonzero(answers["contact_log_odds"] > model.metadata.thresholds.touch[-1])
    best = np.array([best_interval(sample[row], deviation[row], table, real.force_n) for row in seen]).reshape(-1, 2)
    place = place_mm[seen]
    return Contacts(
        place,
        force_n[seen],
        answers["position_low_mm"][seen],
        answers["position_high_mm"][seen],
        best[:, 1] - best[:, 0],
        (best[:, 0] <= place) & (place <= best[:, 1]),
    )


def row(name: str, said: Contacts, part: Bools) -> str:
    """A row of a table: contacts that are held, and the widths."""
    if not part.any():
        return f"| {name} | 0 | - | - | - | - | - |"
    held = (said.low_mm <= said.place_mm) & (said.place_mm <= said.high_mm)
    width, best = (said.high_mm - said.low_mm)[part].mean(), said.best_mm[part].mean()
    shares = f"{100 * held[part].mean():.1f} | {100 * said.best_holds[part].mean():.1f}"
    return f"| {name} | {part.sum()} | {shares} | {width:.1f} | {best:.1f} | {width / best:.2f} |"


def print_table(name: str, said: Contacts, model: ModelFile) -> None:
    """Print the rows of a scene."""
    print(
        f"\n| {name} | seen | held, % | by the best, % | width, mm | best, mm | ratio |\n|---|---|---|---|---|---|---|"
    )
    (low, high), forces = model.metadata.ranges.position_mm, model.metadata.ranges.force_n
    edges = np.linspace(0.0, model.metadata.length_mm, STRETCHES + 1)
    stretch: Indices = np.searchsorted(edges, said.place_mm) - 1
    for number in np.unique(stretch).tolist():
        print(row(f"{edges[number]:g} to {edges[number + 1]:g} mm", said, stretch == number))
    from_end = np.minimum(said.place_mm - low, high - said.place_mm)
    print(row(f"within {LAST_MM} mm of an end", said, np.asarray(from_end < LAST_MM)))
    marks = np.linspace(*forces, FORCES + 1) if forces[0] < forces[1] else np.array([])
    for least, most in zip(marks[:-1].tolist(), marks[1:].tolist(), strict=True):
        print(row(f"{least:g} to {most:g} N", said, (least <= said.force_n) & (said.force_n <= most)))
    print(row("all", said, np.ones(len(said.place_mm), np.bool_)), flush=True)


def of_scene(model: ModelFile, contacts: int) -> None:
    """Print the table of a scene."""
    prior, rng = prior_of_model(model.metadata), np.random.default_rng(43)
    place, force = rng.uniform(*prior.extent.range_mm, contacts), rng.uniform(*prior.force_n, contacts)
    print_table(model.metadata.name, said_of(model, prior, place, force, 1), model)


def of_calibrated(model: ModelFile, contacts: int, surfaces: int, loads: int) -> None:
    """Print a row for each real surface: its sensors have noise and zeros as stated, and their gains stay."""
    name = f"{model.metadata.name}, {loads} loads"
    print(
        f"\n| {name} | seen | held, % | by the best, % | width, mm | best, mm | ratio |\n|---|---|---|---|---|---|---|"
    )
    for seed in range(surfaces):
        rng = np.random.default_rng([seed, 43])
        real = random_imperfections(model.metadata, rng)
        recording = recorded(model.metadata, real, rng, count=loads, hand_mm=0.3)
        try:
            fresh = load_bytes(calibrate(model, recording, silent, effort=Effort(ROUGH)).content, "calibrated")
        except NotGoodEnoughError:
            print(f"| {seed} | refused as no better |")
            continue
        prior = true_prior(model.metadata, real).with_floor(0.0, np.array(model.metadata.floor.zero_mm))
        place, force = rng.uniform(*prior.extent.range_mm, contacts), rng.uniform(*prior.force_n, contacts)
        said = said_of(fresh, prior, place, force, seed)
        print(row(str(seed), said, np.ones(len(said.place_mm), np.bool_)), flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENE_NAMES)
    parser.add_argument("--contacts", type=int, default=10_000)
    parser.add_argument("--calibrated", type=int, default=0, help="real surfaces, instead of the scene's own")
    parser.add_argument("--loads", type=int, default=10)
    options = parser.parse_args(arguments)
    for name in options.scenes:
        if name.endswith(".onnx"):
            model = load(name)
        else:
            with tempfile.TemporaryDirectory() as folder:
                model = build(Path(folder), name)
        if options.calibrated:
            of_calibrated(model, options.contacts, options.calibrated, options.loads)
        else:
            of_scene(model, options.contacts)


if __name__ == "__main__":
    main()
