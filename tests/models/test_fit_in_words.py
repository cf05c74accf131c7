"""What `design-sensors calibrate` says of a fit: each departure in its unit, with the error of each."""

from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.commands.fit_in_words import departures_in_words, each_fine, percent_of, scale_in_words
from beamtouch_models.runtime import ModelFile, load
from beamtouch_models.runtime.departures import Departures
from support.programs.in_process import Refusal

FOUND = Departures(
    position_offset_mm=[1.25, -0.5, 0.0, 3.125],
    gain=[1.03, 0.975, 1.0, 1.0125],
    offset_mm=[0.0125, -0.003, 0.0, 0.00625],
    curve_per_mm=-0.0123,
    fixity=(0.125, 0.0),
    rigidity=0.9375,
)
ERRORS = {
    "rigidity": np.array([0.0125]),
    "gain": np.array([0.005, 0.0075, 0.01, 0.0025]),
    "curve": np.array([0.0045]),
    "offset": np.array([0.001, 0.002, 0.0035, 0.00025]),
}
SHOWN = {
    "rigidity": "-6.25 +- 1.25 %",
    "gain": "s1 +3.00 +- 0.50, s2 -2.50 +- 0.75, s3 +0.00 +- 1.00, s4 +1.25 +- 0.25 %",
    "curve": "-0.0123 +- 0.0045 per mm",
    "offset": "s1 +12.50 +- 1.00, s2 -3.00 +- 2.00, s3 +0.00 +- 3.50, s4 +6.25 +- 0.25 um",
}


def test_departures_are_in_percent_mm_and_um(bench: ModelFile) -> None:
    assert departures_in_words(bench.metadata, FOUND, ERRORS) == SHOWN
    of_beams = {"position": np.array([0.5, 0.25, 0.75, 1.0]), "fixity": np.array([0.02, 0.003])}
    assert departures_in_words(bench.metadata, FOUND, ERRORS | of_beams) == SHOWN | {
        "position": "s1 +1.25 +- 0.50, s2 -0.50 +- 0.25, s3 +0.00 +- 0.75, s4 +3.12 +- 1.00 mm",
        "fixity": "left 0.125 +- 0.020, right 0.000 +- 0.003",
    }


STIFF = FOUND.model_copy(
    update={"across_offset_mm": [0.5, 0.25, -2.0, 0.0], "spring_stiffness": [1.1, 0.95, 1.0, 1.25]}
)
OF_PLATES = {
    "x": np.array([0.5, 0.25, 0.75, 1.0]),
    "y": np.array([0.25, 0.5, 1.25, 0.75]),
    "springs": np.array([0.06, 0.07, 0.08, 0.09]),
}


def test_springs_of_a_plate_are_told_by_their_number_and_whether_the_loads_tell_them(plate_model: Path) -> None:
    metadata = load(plate_model).metadata
    shown = departures_in_words(metadata, STIFF, ERRORS | OF_PLATES)
    assert shown == SHOWN | {
        "x": "s1 +1.25 +- 0.50, s2 -0.50 +- 0.25, s3 +0.00 +- 0.75, s4 +3.12 +- 1.00 mm",
        "y": "s1 +0.50 +- 0.25, s2 +0.25 +- 0.50, s3 -2.00 +- 1.25, s4 +0.00 +- 0.75 mm",
        "springs": "1 +10.00 +- 6.00, 2 -5.00 +- 7.00, 3 +0.00 +- 8.00, 4 +25.00 +- 9.00 %",
    }
    # Six tenths of the 10 % that are plausible before any load.
    for least, hardly in ((0.0599, False), (0.0601, True)):
        errors = ERRORS | {"springs": np.array([0.09, least, 0.08, 0.07])}
        said = departures_in_words(metadata, STIFF, errors)["springs"]
        assert said.endswith("; these loads hardly tell them from gains") is hardly
    assert departures_in_words(metadata, STIFF, ERRORS) == SHOWN  # what was not fitted is not told
    assert departures_in_words(metadata, FOUND, ERRORS | OF_PLATES) == SHOWN


def test_zeros_in_another_unit_are_not_in_um(bench: ModelFile) -> None:
    layout = [channel.model_copy(update={"unit": "uV/V"}) for channel in bench.metadata.layout]
    metadata = bench.metadata.model_copy(update={"layout": layout})
    said = each_fine(metadata, np.array([1234.5, -20.0, 0.0, 7.25]), np.array([12.34, 5.0, 1.0, 0.257]))
    assert said == "s1 1.23 +- 0.012, s2 -0.02 +- 0.005, s3 0 +- 0.001, s4 0.00725 +- 0.00026 uV/V"


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [(0.05263, 0.00567, "5.26 +- 0.57 % more"), (-0.1234, 0.0321, "12.3 +- 3.2 % less"), (0.0, 0.01, "0 +- 1 % more")],
)
def test_a_scale_is_more_or_less_than_the_scene_says(value: float, error: float, text: str) -> None:
    said = f"deflects {text} per newton than the scene says: rigidity, gains or forces"
    assert scale_in_words(value, error) == said


def test_relative_errors_are_one_number_or_a_range() -> None:
    assert percent_of([0.0123, 0.0123]) == "1.2 %"
    assert percent_of([0.0034, 0.01234, 0.002]) == "0.2..1.2 %"


@pytest.mark.parametrize("option", ["--placing-mm", "--force-percent", "--mounting-mm"])
@pytest.mark.parametrize("value", ["0.0009", "50.1", "nan"])
def test_errors_of_loads_that_nobody_has_are_refused(
    refused: Refusal, bench_model: Path, tmp_path: Path, option: str, value: str
) -> None:
    loads = tmp_path / "loads.csv"
    said = refused("calibrate", bench_model, loads, "-o", tmp_path / "out.onnx", option, value)
    assert f"{option} {value} is not from 0.001 to 50" in said
    for end in ("0.001", "50"):  # then the file is read
        said = refused("calibrate", bench_model, loads, "-o", tmp_path / "out.onnx", option, end)
        assert f"{loads}: No such file" in said
