"""Calibration with wrong loads: the loads that are named, and refusals."""

import csv
import dataclasses
import json
import re
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import runtime
from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.calibrate import checked_fit
from beamtouch_models.design.calibration.fit import fit
from beamtouch_models.design.calibration.mistaken import mistaken
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.design.sweeps import silent
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.lab.rig.surface import Imperfections
from models.calibration_files import write_readings
from support.programs.in_process import Command
from support.surfaces.real_surfaces import MISTAKES, deflections_on, random_imperfections, recorded, with_mistake

pytestmark = pytest.mark.long

SMALL = ("conveyor", "20 mm")
"""On 1200 mm this load moves the sensors by less than eight noises."""
MISTYPED = [("cantilever", "20 mm"), ("cantilever", "2 x force")]
SOAKED = [one for one in product(("cantilever", "conveyor"), MISTAKES) if one not in (*MISTYPED, SMALL)]


def change_load(path: Path, number: str, column: str, value: str) -> None:
    """Mistype a number of a load."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows({**row, column: value} if row["load"] == number else row for row in rows)


@pytest.mark.soak
def test_a_mistyped_load_is_named_and_can_be_left_out(
    design_sensors_roughly: Command, built_model: Callable[[str], Path], tmp_path: Path
) -> None:
    path, output, model = tmp_path / "loads.csv", tmp_path / "out.onnx", built_model("cantilever")
    loaded, loads = runtime.load(model), (np.linspace(29.0, 191.0, 10), np.full(10, 2.25))
    real = random_imperfections(loaded.metadata, np.random.default_rng(1))
    write_readings(path, loaded, deflections_on(loaded.metadata, real, *loads), *loads)
    change_load(path, "6", "position_mm", "179")  # by 60 mm: it pressed at 119
    given = ("calibrate", model, path, "-o", output)
    done = design_sensors_roughly(*given)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "load 6 (lines 1002 to 1201) says 179 mm and 2.25 N, but the other loads" in done.stderr
    place = re.search(r"place it at (\S+) mm with (\S+) N", done.stderr)
    assert place is not None
    assert [float(number) for number in place.groups()] == pytest.approx([119, 2.25], rel=0.05)
    assert not output.exists()
    done = design_sensors_roughly(*given, "--leave-out", "6", "--json")
    found = json.loads(done.stdout)
    assert found["loads_left_out"] == [6]
    assert found["error_after_mm"]["mean"] < found["error_before_mm"]["mean"]
    assert output.exists()


@pytest.mark.parametrize(
    ("name", "mistake"),
    [
        *MISTYPED,
        *(pytest.param(*one, marks=pytest.mark.soak) for one in SOAKED),
    ],
)
def test_a_mistyped_load_is_named_and_honest_ones_are_accepted(
    name: str, mistake: str, built_model: Callable[[str], Path]
) -> None:
    metadata, rng = runtime.load(built_model(name)).metadata, np.random.default_rng([5, 5])
    nominal = NominalSurface.of(metadata)
    honest = recorded(metadata, random_imperfections(metadata, rng), rng, hand_mm=0.3)
    place, force, wrong = with_mistake(mistake, honest, metadata.ranges.position_mm, rng)
    loads = dataclasses.replace(honest, place_mm=place, force_n=force)
    assert [one.index for one in mistaken(nominal, loads)] == [wrong]
    assert mistaken(nominal, honest) == ()


def test_a_fit_finds_how_well_loads_are_placed(built_model: Callable[[str], Path]) -> None:
    metadata = runtime.load(built_model("cantilever")).metadata
    nominal, rng = NominalSurface.of(metadata), np.random.default_rng(8)
    real = random_imperfections(metadata, rng)
    well, badly = (
        fit(nominal, recorded(metadata, real, rng, count=30, hand_mm=hand_mm), tuple(nominal.kinds)).errors
        for hand_mm in (0.0, 3.0)
    )
    assert well.placing_mm < 0.3
    assert badly.placing_mm == pytest.approx(3, rel=0.4)
    assert badly.force == pytest.approx(0.03, rel=0.4)
    assert max(well.residual_mm, badly.residual_mm) < metadata.noise.sample_mm


def measured_as(change: Callable[[Floats], Floats]) -> Callable[[Loads], Loads]:
    """Return what gives loads other deflections (loads, channels)."""
    return lambda loads: dataclasses.replace(loads, measured_mm=change(loads.measured_mm))


def exchanged(loads: Loads) -> Loads:
    loads.place_mm[[2, 6]] = loads.place_mm[[6, 2]]
    return loads


def shuffled(loads: Loads) -> Loads:
    # In other orders, the refusal may instead name one or two loads that contradict the others.
    return dataclasses.replace(loads, measured_mm=np.random.default_rng(2).permutation(loads.measured_mm))


def on_supports(loads: Loads) -> Loads:
    """Loads that move no sensor."""
    noise_mm = loads.deviation_mm * np.random.default_rng(2).normal(size=loads.measured_mm.shape)
    ends_mm = np.where(loads.place_mm > 200, 400.0, 0.0)
    return dataclasses.replace(loads, place_mm=ends_mm, measured_mm=noise_mm)


REVERSED = "channels seem to be in reverse order, or positions to be measured from the"
ANOTHER = "nothing was written: the recording does not fit this model's"
EXCHANGED = r"load 3 \(lines .*; load 7 \(lines .*; correct.*--leave-out 3 --leave-out 7"
UNMOVED = "none of the loads moves a sensor; record loads elsewhere"
SWAPPED = "s2 and s3 seem to be swapped"
INVERTED = "s3 seems to be inverted; check the wiring"
Refused = tuple[str, Callable[[Loads], Loads], type[Exception], str]
"""Scene, what changes its loads, the error and its reason."""
REFUSED: dict[str, Refused] = {
    "two exchanged": ("cantilever", exchanged, RecordingError, EXCHANGED),
    "all reversed": ("bench", measured_as(lambda mm: mm[:, ::-1]), RecordingError, REVERSED),
    "of another surface": ("cantilever", measured_as(np.zeros_like), NotGoodEnoughError, ANOTHER),
    "that move no sensor": ("bench", on_supports, NotGoodEnoughError, UNMOVED),
}
REFUSED_SOAKED: dict[str, Refused] = {
    "two swapped": ("bench", measured_as(lambda mm: mm[:, [0, 2, 1, 3]]), RecordingError, SWAPPED),
    "one inverted": ("bench", measured_as(lambda mm: mm * [1, 1, -1, 1]), RecordingError, INVERTED),
    "from the other end": ("bench", measured_as(lambda mm: mm[::-1]), RecordingError, REVERSED),
    "all reversed on a conveyor": ("conveyor", measured_as(lambda mm: mm[:, ::-1]), RecordingError, REVERSED),
    "of a mirrored beam": ("cantilever", measured_as(lambda mm: mm[::-1]), NotGoodEnoughError, ANOTHER),
    "of shuffled loads": ("cantilever", shuffled, NotGoodEnoughError, ANOTHER),
}


@pytest.mark.parametrize("name", [*REFUSED, *(pytest.param(one, marks=pytest.mark.soak) for one in REFUSED_SOAKED)])
def test_loads_that_make_no_model_are_refused_with_the_reason(name: str, built_model: Callable[[str], Path]) -> None:
    scene, change, error, said = (REFUSED | REFUSED_SOAKED)[name]
    model, rng = runtime.load(built_model(scene)), np.random.default_rng([0, 1])
    loads = recorded(model.metadata, random_imperfections(model.metadata, rng), rng)
    with pytest.raises(error, match=said):
        checked_fit(model, change(loads), silent)


def test_a_model_that_is_worse_is_not_written(built_model: Callable[[str], Path]) -> None:
    # Four loads that stand 3 mm off on a surface that does not depart from its scene.
    model = runtime.load(built_model("cantilever"))
    loads = recorded(model.metadata, Imperfections(), np.random.default_rng(6), count=4, hand_mm=3.0)
    with pytest.raises(NotGoodEnoughError) as refused:
        checked_fit(model, loads, silent)
    means = re.search(r"left-out loads to (\S+) mm, the given model to (\S+) mm", str(refused.value))
    assert means is not None
    assert float(means[1]) > 1.05 * float(means[2])
