"""Models calibrated on simulated real beams: their error and width over what is possible, and what was said.

`python tests/benchmarks/real_beams.py` records loads of three weights on random surfaces, placed by hand, runs
`design-sensors calibrate`, and puts 3000 contacts to the model that it writes. `--hanger-n` and `--shift-mm` add a
force to each load, and move each load, without a word in the file. With `--said`, no model is built: it prints what the
fit says of the loads alone.
"""

import argparse
import contextlib
import io
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share

from shipped import build

from beamtouch_models import cli
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.posterior import posterior_quantiles
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.calibration.calibrate import checked_fit
from beamtouch_models.design.calibration.doubts import common_in_words
from beamtouch_models.design.calibration.recordings import read_loads
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.places import on_axis
from beamtouch_models.runtime import ModelFile, load
from models.calibration_files import write_readings
from support.surfaces.real_surfaces import random_imperfections, true_prior

WEIGHTS = (0.25, 0.5, 1.0)
"""Forces of the loads, over the largest of the scene."""
CONTACTS = 3000
LEVELS = (0.025, 0.5, 0.975)
TOLD = ("rigidity", "scale", "forces", "places", "after")
"""Rows of the command that are printed."""
EFFORT = 0.06


def record(path: Path, model: ModelFile, real: Imperfections, seed: int, given: argparse.Namespace, count: int) -> Path:
    """Write a recording of loads that are placed by hand, evenly over the beam, with the weights in random order."""
    rng, (low, high) = np.random.default_rng([seed, count]), model.metadata.ranges.position_mm
    stated_mm = np.linspace(0.95 * low + 0.05 * high, 0.05 * low + 0.95 * high, count)
    largest_n = model.metadata.ranges.force_n[1]
    stated_n = largest_n * rng.permutation(np.resize(WEIGHTS, count))
    at_mm = np.clip(stated_mm + given.shift_mm + given.hand_mm * rng.normal(size=count), low, high)
    pressed_n = stated_n * (1 + 0.01 * given.hand_mm * rng.normal(size=count)) + given.hanger_n
    prior = true_prior(model.metadata, real)
    measured_mm = prior.measured(pressed_n[:, None] * prior.influence_at(on_axis(at_mm)))
    return write_readings(path, model, measured_mm, stated_mm, stated_n)


def calibrated(model: Path, loads: Path, output: Path) -> str:
    """Run the command; returns what it says, of the rows in `TOLD` and of what is no row."""
    out, said = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
        cli.main(["calibrate", str(model), str(loads), "-o", str(output), "--effort", str(EFFORT)])
    rows = [" ".join(line.split()) for line in out.getvalue().splitlines() if line.split()[0] in TOLD]
    return "; ".join([*rows, *said.getvalue().splitlines()])


def said_of(model: ModelFile, loads: Path) -> str:
    """Return what the fit says that all loads share, or why it is refused."""
    try:
        checked = checked_fit(model, read_loads(loads, model.metadata), lambda _doing, _done: None)
    except (RecordingError, NotGoodEnoughError) as error:
        return str(error)
    return "; ".join(common_in_words(checked.fit, checked.sure).values()) or "nothing"


def accuracy(model: ModelFile, real: Imperfections) -> tuple[float, float, float]:
    """Return error and width of a model over those of one that knows the surface, and the share of intervals held."""
    prior = true_prior(model.metadata, real)
    contacts = draw(prior, CONTACTS, 9)
    shown_mm = prior.measured(contacts.deflection_mm)
    whitening = prior_of_model(model.metadata).errors.whitening(shown_mm)
    answers = model.graph.estimate(shown_mm.astype(np.float32), whitening.astype(np.float32))
    levels = np.tile(LEVELS, (CONTACTS, 1))
    low_mm, best_mm, high_mm = posterior_quantiles(prior, contacts.deflection_mm, levels)[0].T
    true_mm = contacts.position_mm
    error = np.abs(answers["position_mm"] - true_mm).mean() / np.abs(best_mm - true_mm).mean()
    wide = (answers["position_high_mm"] - answers["position_low_mm"]).mean() / (high_mm - low_mm).mean()
    held = (answers["position_low_mm"] <= true_mm) & (true_mm <= answers["position_high_mm"])
    return float(error), float(wide), float(held.mean())


def main() -> None:
    """Measure as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="bench")
    parser.add_argument("--surfaces", type=int, default=10)
    parser.add_argument("--loads", type=int, nargs="+", default=[10, 30])
    parser.add_argument("--hand-mm", type=float, default=0.5, help="deviation of loads from where they are said to be")
    parser.add_argument("--hanger-n", type=float, default=0.0)
    parser.add_argument("--shift-mm", type=float, default=0.0)
    parser.add_argument("--said", action="store_true", help="what the fit says alone, without a model")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model, path = build(folder, given.scene), folder / f"{given.scene}.onnx"
        for count in given.loads:
            for seed in range(given.surfaces):
                real = random_imperfections(model.metadata, np.random.default_rng([seed, 7]))
                output = folder / f"{count}-{seed}.onnx"
                loads = record(folder / "loads.csv", model, real, seed, given, count)
                said = said_of(model, loads) if given.said else calibrated(path, loads, output)
                figures = ""
                if output.exists():
                    error, wide, held = accuracy(load(output), real)
                    figures = f"error {error:.3f}, held {held:.3f}, width {wide:.2f}; "
                truth = f"{100 / real.rigidity * np.mean(real.gain) - 100:+.2f} % true; "
                print(f"{count} loads, surface {seed}: {figures}{truth}{said}", flush=True)


if __name__ == "__main__":
    main()
