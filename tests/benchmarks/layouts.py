"""The search for a layout beside the best that is known: every seed, the nine scenes and random ones.

The best known is the best of all seeds, of an enumeration of a coarse grid with every layout near the best refined (two
and three sensors), and of many random starts (more). All are scored on the same contacts with drawn errors, which no
search has seen; `--sets 6` takes six times as many, for rows that one set cannot tell apart. Then what each layout
costs: with the worst sensor failed, over the inner nine tenths of the contacts' range, and over its ends, beside the
paper's layout and equal pitch. A row states the processor time of a search, the median of the seeds. `--failed
0,5,10,100` prints instead, for each share of the time, the error of its layout with all sensors and with the worst one
failed, beside those of the paper's layout, all on the same contacts.
"""

import argparse
import time
from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np

from beamtouch_models.arrays import Indices
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.layout import place_sensors
from beamtouch_models.design.placement.layout_rules import equal_layout
from beamtouch_models.design.placement.least_error import Stages, stages_of
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim, place
from beamtouch_models.design.placement.reasons import costs_of
from beamtouch_models.design.placement.search import refine
from beamtouch_models.design.scene import Scene, load_scene
from beamtouch_models.design.surface import Surface, resolve
from beamtouch_models.design.sweeps import one_thread
from beamtouch_models.errors import SceneError
from support.surfaces.example_scenes import SCENES

JUDGED_BY, COARSE, STARTS, REFINED = 1_000, 16, 8, 4
"""Seed of the judging contacts; places of the enumerated grid; random starts; best of them that are refined."""


def random_scene(seed: int) -> Scene:
    """Return a random beam: length, supports, forces, noise, housings and number of sensors."""
    rng = np.random.default_rng(seed)
    length, weak = float(rng.choice([150, 400, 900])), float(rng.uniform(1, 10))
    supports = str(rng.choice(["simply-supported", "fixed-fixed", "cantilever"]))
    beam = {"length_mm": length, "flexural_rigidity_n_mm2": 40.0 * length**3, "supports": supports}
    force = weak if seed % 3 == 0 else (weak, weak * float(rng.uniform(1.5, 12)))
    low = 0.25 * length if supports == "cantilever" else 0.02 * length
    contact = {"force_n": force, "position_mm": (low, 0.98 * length)}
    sensors = {
        "noise_percent_of_max": float(10 ** rng.uniform(-1, 0.3)),
        "size_mm": float(rng.choice([8, 16])),
        "range_mm": (1.0, 9.0),
        "rate_hz": 200.0,
    }
    return Scene.model_validate({"beam": beam, "contact": contact, "sensors": sensors})


def stages_for(surface: Surface, count: int, seed: int, share: float) -> tuple[Stages, Indices, Indices]:
    """Return the stages of a search, the paper's layout and the one nearest to equal pitch."""
    rules, influence = surface.rules, surface.influence
    equal = equal_layout(rules, influence.size_mm, count)
    product = np.searchsorted(rules.place_mm[:, 0], place(influence, rules, count, seed).positions_mm)
    return stages_of(influence, rules, equal, product, surface.sampling, share, seed, USUAL), product, equal


def candidates(stages: Stages, count: int) -> Iterator[Indices]:
    """Yield layouts to refine for the best known: all of a coarse grid, or random ones."""
    rules, rng = stages.rough.rules, np.random.default_rng(5)
    if count <= 3:
        every = np.array(list(combinations(np.unique(rules.evenly(COARSE)), count)), dtype=np.intp)
    else:
        drawn = rng.uniform(rules.place_mm.min(), rules.place_mm.max(), size=(STARTS, count, 1))
        every = np.array([layout for wanted in drawn if (layout := rules.fitted(wanted)) is not None])
        every = np.array([refine(stages.rough, layout, 2_000, rules.ticks_across // 8).layout for layout in every])
    scores = stages.rough.scores(every)
    for row in np.argsort(-scores)[:REFINED]:
        if stages.fine.scores(every[row][None])[0] > -np.inf:
            yield refine(stages.fine, every[row], 2_000, rules.ticks_across // 16).layout


def row_of(name: str, surface: Surface, count: int, seeds: int, aim: Aim, sets: int) -> dict[str, Any]:
    """Return how far each seed is from the best known, and what the layout of the first costs where."""
    rules, found, times = surface.rules, [], []
    for seed in range(seeds):
        started = time.process_time()
        places = place_sensors(surface, count=count, seed=seed, aim=aim).placement.positions_mm
        times.append(time.process_time() - started)
        found.append(np.searchsorted(rules.place_mm[:, 0], places))
    share = (surface.scene.requirements.failed_percent if aim.failed_percent is None else aim.failed_percent) / 100
    stages, product, equal = stages_for(surface, count, JUDGED_BY, share)
    known = list(candidates(stages, count))
    layouts = [rules.place_mm[layout] for layout in (found[0], product, equal)]
    costs = costs_of(surface.influence, surface.errors, layouts, JUDGED_BY)
    mm = 100 / surface.influence.diagonal_mm
    judges = [stages, *(stages_for(surface, count, JUDGED_BY + number, share)[0] for number in range(1, sets))]
    scores = [float(np.mean([judge.drawn.error_mm(layout) for judge in judges])) for layout in (*found, *known)]
    ratios = [score / min(scores) for score in scores[:seeds]]
    return {
        "scene": name, "sensors": count, "worst": max(ratios), "ratios": ratios, "s": float(np.median(times)),
        "places": rules.place_mm[found[0], 0].tolist(),
        "best": rules.place_mm[[*found, *known][int(np.argmin(scores))], 0].tolist(),
        "costs": {
            each: [value * mm for value in (one.all_mm, max(one.failed_mm), one.inner_mm, one.ends_mm)]
            for each, one in zip(("ours", "paper", "equal"), costs, strict=True)
        },
    }  # fmt: skip


def weighed(name: str, surface: Surface, count: int, percents: list[float], effort: Effort) -> str:
    """Return the row of a table: what a failure that counts so much makes of the layout."""
    papers = place(surface.influence, surface.rules, count, 0).place_mm
    layouts = [papers]
    for percent in percents:
        aim = Aim(DEFAULT_AIM.criterion, percent, effort=effort)
        layouts.append(place_sensors(surface, count=count, aim=aim).placement.place_mm)
    costs, share = costs_of(surface.influence, surface.errors, layouts, JUDGED_BY), 100 / surface.influence.diagonal_mm
    cells = [f"{one.all_mm * share:.2f}, {max(one.failed_mm) * share:.3g}" for one in costs]
    return f"| {name}, {count} | {' | '.join(cells)} |"


def main() -> None:
    """Print a row for each scene and number of sensors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", default="all", help="names of shipped scenes with commas; all; none")
    parser.add_argument("--random", type=int, default=0, metavar="N", help="number of random scenes")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="seed of the first random scene")
    parser.add_argument("--sets", type=int, default=1, help="sets of contacts that judge")
    parser.add_argument("--counts", default="2,3,4,5,6", help="numbers of sensors")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--effort", type=float, default=1.0)
    parser.add_argument("--failed", default="", metavar="PERCENTS", help="shares of the time with commas: print these")
    options = parser.parse_args()
    beams = [path.stem for path in sorted(SCENES.glob("*.toml")) if load_scene(path)[0].plate is None]
    names = beams if options.scenes == "all" else []
    names = names or [name for name in options.scenes.split(",") if name != "none"]
    scenes = [(name, load_scene(SCENES / f"{name}.toml")[0]) for name in names]
    scenes += [(f"random {seed}", random_scene(seed)) for seed in range(options.first, options.first + options.random)]
    aim = Aim(DEFAULT_AIM.criterion, effort=Effort(options.effort))
    print("scene, sensors: worst seed over the best known, s; layout; error of all, worst failed, inner, ends in %")
    with one_thread():
        for name, scene in scenes:
            surface = resolve(scene)
            for count in map(int, options.counts.split(",")):
                if options.failed:
                    print(
                        weighed(name, surface, count, [*map(float, options.failed.split(","))], aim.effort), flush=True
                    )
                    continue
                try:
                    row = row_of(name, surface, count, options.seeds, aim, options.sets)
                except SceneError as error:
                    print(f"{name}, {count}: {error}")
                    continue
                costs = [
                    f"{each} " + ", ".join(f"{value:.2f}" for value in values) for each, values in row["costs"].items()
                ]
                found = f"{row['worst']:.3f}, {row['s']:.1f} s; {row['places']} (best {row['best']})"
                print(f"{name}, {count}: {found}; {'; '.join(costs)}", flush=True)


if __name__ == "__main__":
    main()
