"""Recorded loads in which something is wrong: how often `calibrate` names it; and how often it refuses honest ones.

`python tests/benchmarks/bench_calibration.py --runs 200` prints a row per scene and mistyped load as it is measured,
and with `--doubts` one per scene and other fault of a recording, with the share of stated intervals that hold the
truth.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from beamtouch_models.places import on_axis

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share

from shipped import build

from beamtouch_models.design.calibration.calibrate import checked_fit
from beamtouch_models.design.calibration.choice import has_one_scale, shares_of_scale
from beamtouch_models.design.calibration.fit import Fit
from beamtouch_models.design.calibration.nominal_surface import GAIN, RIGIDITY
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.calibration.session import SHIFT, WEIGHT
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.runtime import ModelFile
from models.doubtful_recordings import WRONG, doubtful
from support.surfaces.real_surfaces import MISTAKES, random_imperfections, recorded, true_prior, with_mistake

SCENE_NAMES = ("bench", "conveyor", "cantilever")
SIDES, PLACES = 1.96, 9
"""Half of an interval of 95 %, in standard errors, and number of places of contacts over the range."""
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
            place, force, row = with_mistake(mistake, loads, model.metadata.ranges.position_mm, rng)
            loads, wrong = replace(loads, place_mm=place, force_n=force), int(loads.number[row])
        counts[outcome(model, loads, wrong)] += 1
    wanted = "accepted" if mistake == "none" else "named"
    row_name = f"{name}, {mistake}" + (f", placed to {hand_mm:g} mm" if hand_mm else "")
    row_name += ", anywhere" if anywhere else ""
    return {"name": row_name, "value": counts[wanted] / runs, "unit": wanted, "goal": 0.99, "runs": runs, **counts}


def doubted(name: str, wrong: str, runs: int) -> dict[str, object]:
    """Count what is named over random surfaces, and the stated intervals that hold the truth in what is accepted."""
    model = model_of(name)
    counts = dict.fromkeys(("named", "misnamed", "refused", "accepted"), 0)
    held: dict[str, list[bool]] = {"gains": [], "positions": [], "forces": []}
    for seed in range(runs):
        rng = np.random.default_rng([seed, 7])
        real = random_imperfections(model.metadata, rng)
        loads, named = doubtful(model.metadata, real, wrong, rng)
        try:
            checked = checked_fit(model, loads, lambda _doing, _done: None)
        except RecordingError as error:
            counts["named" if named and str(error).startswith(named) else "misnamed"] += 1
        except NotGoodEnoughError:
            counts["refused"] += 1
        else:
            named_here = {"hanger": (WEIGHT,), "shift": (SHIFT,)}.get(wrong, ())
            counts["misnamed" if set(checked.sure) - set(named_here) else "named" if checked.sure else "accepted"] += 1
            for kind, values in holding(model, checked.fit, real).items():
                held[kind] += values
    wanted = "accepted" if wrong in {"none", "drift"} else "named"
    shares = {kind: round(float(np.mean(values)), 3) for kind, values in held.items() if values}
    row = {"name": f"{name}, {wrong}", "value": counts[wanted] / runs, "unit": wanted, "goal": 0.95, "runs": runs}
    return {**row, **counts, **shares}


def holding(model: ModelFile, found: Fit, real: Imperfections) -> dict[str, list[bool]]:
    """Return whether the stated 95 % intervals of gains, positions and forces hold the truth.

    Forces are those of contacts at known places over the range, by all channels alike. Gains are beside what all have
    in common, if loads show its product with the rigidity only.
    """
    nominal, metadata = found.nominal, model.metadata
    truth = nominal.vector_of(real.departures(len(metadata.layout)))
    if has_one_scale(found):
        gain, rigidity = nominal.kinds["gain"], nominal.kinds["rigidity"]
        common = shares_of_scale(found.vector[gain]) @ truth[gain]
        truth[rigidity] -= GAIN / RIGIDITY * common
        truth[gain] -= common
    inside = np.abs(found.vector[: nominal.size] - truth) <= SIDES * found.spread[: nominal.size]
    places_mm, force_n = np.linspace(*metadata.ranges.position_mm, PLACES), np.full(PLACES, metadata.ranges.force_n[1])
    shown_mm = nominal.curve(found.vector).measured_mm(on_axis(places_mm), force_n)
    prior = true_prior(metadata, real)
    true_mm = prior.measured(force_n[:, None] * prior.influence_at(on_axis(places_mm)))
    slopes = nominal.slopes(found.vector[: nominal.size], places_mm, force_n, tuple(nominal.kinds))
    along = shown_mm / (shown_mm**2).sum(axis=1, keepdims=True)
    # The zeros of the recording are taken away by the next tare.
    share = ((true_mm - shown_mm + np.array(found.departures.offset_mm)) * along).sum(axis=1)
    slopes[..., nominal.kinds["offset"]] = 0.0
    of_force = np.einsum("lc,lcv->lv", along, slopes)
    covariance = found.covariance[: nominal.size, : nominal.size]
    error = np.sqrt(np.einsum("lv,vw,lw->l", of_force, covariance, of_force))
    forces = (np.abs(share) <= SIDES * error).tolist()
    gains, positions = (inside[nominal.kinds[kind]].tolist() for kind in ("gain", "position"))
    return {"gains": gains, "positions": positions, "forces": forces}


def rows(
    runs: int, mistakes: Sequence[str], names: Sequence[str], hand_mm: float, *, anywhere: bool
) -> Iterator[dict[str, object]]:
    """Measure each scene with each mistake."""
    for mistake in mistakes:
        for name in names:
            yield measured(name, mistake, runs, hand_mm, anywhere=anywhere)


def run() -> list[dict[str, object]]:
    """Rows for `make bench`."""
    loads = rows(RUNS, ("none", "60 mm"), SCENE_NAMES, 0.0, anywhere=False)
    return [*loads, *(doubted("cantilever", wrong, RUNS) for wrong in WRONG)]


def main() -> None:
    """Measure as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--mistakes", nargs="+", choices=("none", *MISTAKES), default=("none", *MISTAKES))
    parser.add_argument("--scenes", nargs="+", choices=SCENE_NAMES, default=SCENE_NAMES)
    parser.add_argument("--hand-mm", type=float, default=0.0, help="deviation of loads from where they are said to be")
    parser.add_argument("--anywhere", action="store_true", help="random positions and forces, not even and equal ones")
    parser.add_argument("--doubts", action="store_true", help="other faults of a recording, instead of mistyped loads")
    options = parser.parse_args()
    if options.doubts:
        for name, wrong in product(options.scenes, WRONG):
            print(doubted(name, wrong, options.runs), flush=True)
        return
    for row in rows(options.runs, options.mistakes, options.scenes, options.hand_mm, anywhere=options.anywhere):
        print(row, flush=True)


if __name__ == "__main__":
    main()
