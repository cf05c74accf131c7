"""The bounds of what a model file states of itself: each is taken, and what is next to it refused."""

import pytest
from pydantic import ValidationError

from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.departures import Calibration, Departures
from beamtouch_models.runtime.metadata_parts import FilterChoice, Floor

TINY = 1e-300


@pytest.mark.parametrize(
    ("part", "field", "taken", "refused"),
    [
        *[("sensor", "adc_bits", 6, 5), ("sensor", "adc_bits", 16, 17)],
        *[("filter", "window", 1, 0), ("filter", "longest", 1, 0), ("filter", "settling_ms", 0.0, -TINY)],
        *[("noise", "reading_mm", 0.0, -TINY), ("floor", "drift_mm_per_min", 0.0, -TINY)],
        *[("placed", "failed_percent", 0.0, -TINY), ("placed", "failed_percent", 100.0, 100.001)],
        *[("influence", "mm_per_n", [[0.5]] * 4, [[0.5]] * 3), ("golden", "deflection_mm", [[0.5]], [])],
        *[("golden", "whitening_per_mm", [[[0.5]]], []), ("drawn", "at_mm", [0.5, 1.5], [0.5])],
        *[("drawn", "load_mm", [0.5], []), ("smallest_force", "force_n", [None], [0.0])],
        *[("thresholds", "touch", [0.0], [-TINY]), ("thresholds", "rest", [1e6], [1_000_000.5])],
    ],
)
def test_a_part_of_the_metadata_has_bounds(
    bench: ModelFile, part: str, field: str, taken: object, refused: object
) -> None:
    stated = getattr(bench.metadata, part)
    members = stated.model_dump() | ({"position_mm": [0.5]} if part == "smallest_force" else {})
    assert getattr(type(stated).model_validate(members | {field: taken}), field) == taken
    with pytest.raises(ValidationError, match=field):
        type(stated).model_validate(members | {field: refused})


@pytest.mark.parametrize("field", ["loads", "contacts", "residual_mm", "force_error"])
def test_a_calibration_counts_from_0_on(field: str) -> None:
    departures = {"position_offset_mm": [0.5], "gain": [1.5], "offset_mm": [0.5]}
    stated = {"departures": departures, "fitted": [], "loads": 3, "residual_mm": 0.5}
    assert getattr(Calibration.model_validate(stated | {field: 0}), field) == 0
    with pytest.raises(ValidationError, match=field):
        Calibration.model_validate(stated | {field: -1})


def test_what_metadata_leaves_out_changes_nothing() -> None:
    """A file need not state what is so without any filter, drift, calibration or curve."""
    plain = FilterChoice()
    assert (plain.window, plain.settling_ms, plain.max_readings) == (1, 0, 1)
    assert Floor(gain=[0.5], zero_mm=[0.5]).drift_mm_per_min == 0
    departures = Departures(position_offset_mm=[0.5], gain=[1.5], offset_mm=[0.5])
    assert (departures.curve_per_mm, departures.fixity, departures.rigidity) == (0, (0, 0), 1)
    calibration = Calibration(departures=departures, fitted=[], loads=3, residual_mm=0.5)
    assert (calibration.contacts, calibration.force_error) == (0, 0)
