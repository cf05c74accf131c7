"""Recorded loads with one that was mistyped: how often `calibrate` names it; and how often it refuses honest ones.

`python tests/benchmarks/bench_calibration.py --runs 200` prints a row per scene and mistake as it is measured.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share

from shipped import build

from beamtouch_models.calibration.calibrate import checked_fit
from beamtouch_models.calibration.recordings import Loads, RecordingError
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.modelfile import ModelFile
from real_surfaces import MISTAKES, random_imperfections, recorded, with_mistake

SCENE_NAMES = ("bench", "conveyor", "cantilever")
RUNS = 6
"""Per scene and mistake in `make bench`."""


def model_of(name: str) -> ModelFile:
    """Build a shipped scene."""
    with tempfile.TemporaryDirectory() as folder:
        return build(Path(folder), name)


def outcome(model: ModelFile, loads: Loads, wrong: int | None) -> str:
    """Say what `calibrate` does: named, misnamed, refused without a name, or accepted."""
    try:
        checked_fit(model, loads, lambda _doing, _done: None)
    except RecordingError as error:
        named = [int(number) for number in loads.number if f"load {number} (lines" in str(error)]
        return "named" if named == [wrong] else "named with others" if wrong in named else "misnamed"
    except NotGoodEnoughError:
        return "refused"
    return "accepted"


def measured(name: str, mistake: str, runs: int, hand_mm: float, *, anywhere: bool) -> dict[str, object]:
    """Count the outcomes over random surfaces, loads and rows."""
    model, counts = model_of(name), dict.fromkeys(("named", "named with others", "misnamed", "refused", "accepted"), 0)
    for seed in range(runs):
        rng = np.random.default_rng([seed, 7])
        real = random_imperfections(model.metadata, rng)
        loads = recorded(model.metadata, real, rng, hand_mm=hand_mm, anywhere=anywhere)
        wrong = None
        if mistake != "none":
            position, force, row = with_mistake(mistake, loads, model.metadata.ranges.position_mm, rng)
            loads, wrong = replace(loads, position_mm=position, force_n=force), int(loads.number[row])
        counts[outcome(model, loads, wrong)] += 1
    wanted = "accepted" if mistake == "none" else "named"
    row_name = f"{name}, {mistake}" + (f", placed to {hand_mm:g} mm" if hand_mm else "")
    row_name += ", anywhere" if anywhere else ""
    return {"name": row_name, "value": counts[wanted] / runs, "unit": wanted, "goal": 0.99, "runs": runs, **counts}


def rows(
    runs: int, mistakes: Sequence[str], names: Sequence[str], hand_mm: float, *, anywhere: bool
) -> Iterator[dict[str, object]]:
    """Measure each scene with each mistake."""
    for mistake in mistakes:
        for name in names:
            yield measured(name, mistake, runs, hand_mm, anywhere=anywhere)


def run() -> list[dict[str, object]]:
    """Rows for `make bench`."""
    return list(rows(RUNS, ("none", "60 mm"), SCENE_NAMES, 0.0, anywhere=False))


def main() -> None:
    """Measure as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--mistakes", nargs="+", choices=("none", *MISTAKES), default=("none", *MISTAKES))
    parser.add_argument("--scenes", nargs="+", choices=SCENE_NAMES, default=SCENE_NAMES)
    parser.add_argument("--hand-mm", type=float, default=0.0, help="deviation of loads from where they are said to be")
    parser.add_argument("--anywhere", action="store_true", help="random positions and forces, not even and equal ones")
    options = parser.parse_args()
    for row in rows(options.runs, options.mistakes, options.scenes, options.hand_mm, anywhere=options.anywhere):
        print(row, flush=True)


if __name__ == "__main__":
    main()
