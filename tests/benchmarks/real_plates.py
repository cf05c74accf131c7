"""Models of plates calibrated on simulated real plates: their error and width over what is possible, and what was said.

`python tests/benchmarks/real_plates.py` records loads of three weights on random plates on springs, placed by hand on a
grid, fits them as `design-sensors calibrate` does, and puts contacts to the estimator of the fit, beside one that knows
the plate.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibration.calibrate import checked_fit, left_open, remade
from beamtouch_models.design.calibration.doubts import common_in_words
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.places import distances_mm
from beamtouch_models.runtime import ModelFile, load
from beamtouch_models.runtime.departures import Calibration, Departures
from beamtouch_models.runtime.session import Answers, runner, stated_mm
from support.surfaces.plate_models import write_plate_model
from support.surfaces.real_surfaces import random_imperfections, recorded, true_prior

WEIGHTS = (0.25, 0.5, 1.0)
"""Forces of the loads, over the largest of the scene."""
AXES = ("x", "y")


def recording(model: ModelFile, real: Imperfections, rng: np.random.Generator, given: argparse.Namespace) -> Loads:
    """Return loads on a grid, with the weights in random order, placed by hand; a hanger is not stated."""
    plain = recorded(model.metadata, real, rng, count=given.along, hand_mm=given.hand_mm)
    forces_n = model.metadata.ranges.force_n[1] * rng.permutation(np.resize(WEIGHTS, len(plain.number)))
    measured_mm = plain.measured_mm * ((forces_n + given.hanger_n) / plain.force_n)[:, None]
    return replace(plain, force_n=forces_n, measured_mm=measured_mm)


def answers_of(model: ModelFile, prior: Prior, departures: Departures, shown_mm: Floats) -> Answers:
    """Return the answers of the estimator of a prior to samples (contacts, channels)."""
    calibration = Calibration(departures=departures, fitted=[], loads=0, residual_mm=0.0)
    run = runner(to_bytes(remade(model.metadata, prior, calibration).graph))
    return run(shown_mm, prior.errors.whitening(shown_mm))


def wide_mm(answers: Answers) -> float:
    """Return the mean length of the intervals along both axes."""
    return float(np.mean([answers[f"{axis}_high_mm"] - answers[f"{axis}_low_mm"] for axis in AXES]))


def main() -> None:
    """Measure as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--surfaces", type=int, default=10)
    parser.add_argument("--along", type=int, default=4, help="loads along each axis")
    parser.add_argument("--hand-mm", type=float, default=0.5, help="deviation of loads from where they are said to be")
    parser.add_argument("--hanger-n", type=float, default=0.0)
    parser.add_argument("--contacts", type=int, default=1000)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        write_plate_model(Path(name))
        model = load(Path(name) / "plate.onnx")
    for seed in range(given.surfaces):
        rng = np.random.default_rng([seed, 7])
        real = random_imperfections(model.metadata, rng)
        try:
            checked = checked_fit(model, recording(model, real, rng, given), lambda _doing, _done: None)
        except (RecordingError, NotGoodEnoughError) as error:
            print(f"plate {seed}: {error}", flush=True)
            continue
        gain, zero_mm, _ = left_open(model.metadata, checked.fit)
        found, knowing = checked.fit.departures, true_prior(model.metadata, real)
        contacts = draw(knowing, given.contacts, 9)
        # The next tare takes the zeros of the recording away.
        own = found.model_copy(update={"offset_mm": [0.0] * len(model.channels)})
        shown_mm = knowing.measured(contacts.deflection_mm)
        ours = answers_of(model, checked.fit.nominal.prior_with(own).with_floor(gain, zero_mm), own, shown_mm)
        best = answers_of(model, knowing, real.departures(len(model.channels), of_plate=True), shown_mm)
        off, least = (distances_mm(stated_mm(one, AXES) - contacts.place_mm).mean() for one in (ours, best))
        held = [
            np.mean((ours[f"{axis}_low_mm"] <= true) & (true <= ours[f"{axis}_high_mm"]))
            for axis, true in zip(AXES, contacts.place_mm.T, strict=True)
        ]
        told = "; ".join(common_in_words(checked.fit, checked.sure).values()) or "nothing said of all loads"
        print(
            f"plate {seed}: error {off:.3f} mm, {off / least:.3f} of that of one who knows the plate; held "
            f"{100 * held[0]:.1f} and {100 * held[1]:.1f} %, width {wide_mm(ours) / wide_mm(best):.2f}; loads before "
            f"{checked.before_mm.mean():.2f}, after {checked.after_mm.mean():.2f} mm; {told}",
            flush=True,
        )


if __name__ == "__main__":
    main()
