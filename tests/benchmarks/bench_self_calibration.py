"""Self-calibration: position error and coverage of models before and after, on surfaces that depart from their scenes.

`python tests/benchmarks/bench_self_calibration.py --runs 20` prints a row per scene and case as it is measured. The
best error is that of an estimator that knows the real surface, on the same contacts.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.calibrated import prior_of_model

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share

from bench_calibration import model_of

from beamtouch_models.design.accuracy import limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibration.calibrate import remade
from beamtouch_models.design.calibration.self_calibrate import calibrated_prior, self_fit
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.sweeps import silent
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.session import Answers, Run, runner
from support.surfaces.real_surfaces import true_prior
from support.surfaces.unlabelled_contacts import Kind, drawn, surface

SCENE_NAMES = ("bench", "conveyor", "stepped")
CASES = {
    "gains": (200, Kind()),
    "gains, 20 contacts": (20, Kind()),
    "gains, 1 mm": (200, Kind(position_mm=1.0)),
    "gains, 1 mm, a tenth two at once": (200, Kind(position_mm=1.0, two_at_once=0.1)),
    "gains, 1 mm, 20 contacts": (20, Kind(position_mm=1.0)),
    "gains, 1 mm, bend 1.5 %": (200, Kind(position_mm=1.0, curve=0.015)),
    "gains, 1 mm, 200 readings each": (200, Kind(position_mm=1.0, readings=200)),
    "nothing": (200, Kind(gain=0.0)),
    "gains, ends fixed by 0.03": (200, Kind(fixity=(0.03, 0.03))),
    "gains, ends fixed by 0.1": (200, Kind(fixity=(0.1, 0.1))),
    "gains, 1 mm, ends fixed by 0.1": (200, Kind(position_mm=1.0, fixity=(0.1, 0.1))),
    "gains, one place": (200, Kind(places_mm=(0.4,))),
    "gains, two places": (200, Kind(places_mm=(0.25, 0.75))),
}
"""Numbers of contacts, with gains 2 % off and sensors 1 mm off; places are shares of the length."""
RUNS = 4
"""Per scene and case in `make bench`."""
DRAWS = 1500


@dataclass(frozen=True)
class Measured:
    """A surface."""

    before: float
    """Mean position error of the given model, in percent of the length."""
    after: float
    best: float
    """The same of an estimator that knows the surface."""
    held_before: float
    """Share of positions inside their intervals."""
    held: float
    force_held_before: float
    force_held: float


def answered(run: Run, prior: Prior, reading_mm: np.ndarray) -> Answers:
    """Answers of a graph to settled samples, with the floor of its prior."""
    return run(reading_mm.astype(np.float32), prior.errors.whitening(reading_mm).astype(np.float32))


def held(answers: Answers, quantity: str, truth: np.ndarray) -> float:
    """Share of the truth inside its interval."""
    low, high = (answers[name] for name in quantity.split())
    return float(((low <= truth) & (truth <= high)).mean())


def measured(model: ModelFile, real: Imperfections, number: int, kind: Kind, seed: int) -> Measured | None:
    """Calibrate from contacts of a surface, and measure on others; None if refused."""
    metadata, rng = model.metadata, np.random.default_rng([seed, 11])
    try:
        found = self_fit(model, drawn(metadata, real, kind, rng, number), lambda _doing, _done: None)
    except NotGoodEnoughError as error:
        print(f"  {seed}: {error}", file=sys.stderr)
        return None
    prior, calibration = calibrated_prior(metadata, found)
    made = runner(to_bytes(remade(metadata, prior, calibration, silent).graph))
    truth = true_prior(metadata, real)
    fresh = draw(truth, DRAWS, seed)
    reading = truth.measured(fresh.deflection_mm)
    old = answered(model.run, prior_of_model(metadata), reading)
    new = answered(made, prior, reading)
    best = limit.posterior_median_mm(truth, fresh.deflection_mm)

    def mean_error(estimate_mm: np.ndarray) -> float:
        return float(np.abs(estimate_mm - fresh.position_mm).mean() / metadata.length_mm * 100)

    sides, forces = "position_low_mm position_high_mm", "force_low_n force_high_n"
    return Measured(
        mean_error(old["position_mm"]),
        mean_error(new["position_mm"]),
        mean_error(best),
        held(old, sides, fresh.position_mm),
        held(new, sides, fresh.position_mm),
        held(old, forces, fresh.force_n),
        held(new, forces, fresh.force_n),
    )


def row(model: ModelFile, case: str, runs: int) -> dict[str, object]:
    """Measure a case over random surfaces."""
    number, kind = CASES[case]
    places = tuple(share * model.metadata.length_mm for share in kind.places_mm)
    kind = Kind(**{**kind.__dict__, "places_mm": places})
    found = []
    for seed in range(runs):
        real = surface(model.metadata, kind, np.random.default_rng([seed, 7]))
        found.append(measured(model, real, number, kind, seed))
    kept = [one for one in found if one is not None]
    told: dict[str, object] = {"name": f"{model.metadata.name}, {case}", "runs": runs, "refused": runs - len(kept)}
    if not kept:
        return told | {"value": None, "unit": "all refused"}
    table = np.array([list(one.__dict__.values()) for one in kept])
    mean, ratio = table.mean(axis=0), table[:, 1] / table[:, 2]
    return told | {
        "value": float(mean[1]),
        "unit": "% error after",
        "before": float(mean[0]),
        "best": float(mean[2]),
        "after over best": float(mean[1] / mean[2]),
        "worst": float(ratio.max()),
        "worse than before": int((table[:, 1] > table[:, 0]).sum()),
        "held": float(mean[4]),
        "least held": float(table[:, 4].min()),
        "held before": float(mean[3]),
        "force held": float(mean[6]),
        "force held before": float(mean[5]),
    }


def rows(runs: int, names: Sequence[str], cases: Sequence[str]) -> Iterator[dict[str, object]]:
    """Measure each scene with each case."""
    for name in names:
        model = model_of(name)
        for case in cases:
            yield row(model, case, runs)


def run() -> list[dict[str, object]]:
    """Rows for `make bench`."""
    return list(rows(RUNS, SCENE_NAMES[:1], tuple(CASES)[:4]))


def main() -> None:
    """Measure as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=tuple(CASES))
    parser.add_argument("--scenes", nargs="+", choices=SCENE_NAMES, default=SCENE_NAMES)
    options = parser.parse_args()
    for one in rows(options.runs, options.scenes, options.cases):
        print({key: round(value, 3) if isinstance(value, float) else value for key, value in one.items()}, flush=True)


if __name__ == "__main__":
    main()
