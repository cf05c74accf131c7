"""What a layout is offered instead, where sensors of earlier builds go, and the drift that a daemon follows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import change_scene, read_scene
from beamtouch_models.design.building.compared import Compared
from beamtouch_models.design.building.mounted import Mounted
from beamtouch_models.design.building.recorded_noise import independent_variance
from beamtouch_models.design.placement.reasons import Costs
from beamtouch_models.design.pricing.walk import smallest_mm, walk_of
from beamtouch_models.design.surface import resolve
from beamtouch_models.places import Extent
from beamtouch_models.runtime.metadata_parts import Influence
from support.surfaces.example_scenes import SCENES
from support.surfaces.small_model import model_of

BENCH = read_scene(SCENES / "bench.toml")


def costs(all_mm: float, failed_mm: list[float]) -> Costs:
    cell, failed = np.ones(1), np.array(failed_mm).reshape(-1, 1)
    return Costs(np.ones((3, 1)), Extent.of_beam((0.0, 400.0)), 200.0 * np.ones((1, 1)), cell, all_mm * cell, failed)


def offered(other_mm: float, failed_mm: list[float], *, with_other: bool = True) -> str:
    positions = {"this layout": np.array([1.0, 2.0]), "if no sensor failed": np.array([80.0, 120.5])}
    each = {"this layout": costs(2.0, failed_mm), "if no sensor failed": costs(other_mm, [4.0, 5.678])}
    if not with_other:
        del each["if no sensor failed"]
    return Compared(positions, each, []).offer


def test_a_layout_that_errs_clearly_less_while_all_work_is_offered_with_its_price() -> None:
    assert offered(1.51234, [2.2, 3.14159, 2.9]) == (
        "80, 120.5 mm would err 24 % less, 1.51 mm, while all sensors work, "
        "and 5.68 mm instead of 3.14 mm with the worst one failed: --failed-percent 0"
    )
    assert offered(1.95, [2.2]) == ""
    assert offered(1.93, [2.2]) != ""
    assert offered(1.5, []) == ""
    assert offered(1.5, [2.2], with_other=False) == ""


def test_sensors_that_move_are_told_from_where_to_where() -> None:
    mounted = Mounted(Path("skin.onnx"), (30.0, 120.0, 260.0))
    assert mounted.moves_to((260.0, 30.0, 120.0)) == ""
    assert mounted.moves_to((30.0, 125.0, 260.0)) == "sensors are not where skin.onnx had them: 120 -> 125 mm"
    assert mounted.moves_to((24.0, 120.0, 266.0)) == (
        "sensors are not where skin.onnx had them: 30 -> 24, 260 -> 266 mm"
    )
    assert mounted.moves_to((30.0, 125.0)) == (
        "sensors are not where skin.onnx had them: 30, 120, 260 mm; now 30, 125 mm"
    )


@pytest.mark.parametrize(
    ("places", "fits"),
    [
        ((30.0, 120.0, 260.0, 300.0), True),
        ((30.0, 120.0, 260.0), False),  # of four
        ((30.0, 120.0, 260.0, 300.0, 350.0), False),
        ((30.0, 125.0, 260.0, 300.0), False),  # one of 120 mm is fixed
        ((30.0, 120.0, 260.0, 265.0), False),  # closer than their housings
    ],
)
def test_places_of_an_earlier_build_fit_if_the_scene_allows_them(places: tuple[float, ...], *, fits: bool) -> None:
    assert Mounted(Path("skin.onnx"), places).fits(change_scene(BENCH, sensors={"fixed_mm": [120.0]})) == fits


def test_a_drift_is_followed_to_half_of_the_least_deflection_or_four_of_its_own_after_a_tare() -> None:
    """Three sensors under 1 N, at most 0.05, 0.04 and 0.02 mm."""
    rows = [[0.01, 0.05, 0.02], [0.03, 0.02, -0.01], [0.01, 0.01, 0.01], [-0.02, -0.04, 0.01]]
    metadata = model_of().metadata.model_copy(update={"influence": Influence(mm_per_n=rows)})
    assert smallest_mm(metadata) == pytest.approx([0.03, 0.05, 0.02])
    stronger = metadata.ranges.model_copy(update={"force_n": (3.0, 20.0)})
    assert smallest_mm(metadata.model_copy(update={"ranges": stronger})) == pytest.approx([0.09, 0.15, 0.06])
    readings = replace(resolve(BENCH).readings, drift_mm_per_min=0.007, zero_mm=0.001, warmth_mm=0.0)
    walk = walk_of(metadata, readings)
    assert walk is not None
    assert (walk.rate_mm_per_min, walk.max_mm) == pytest.approx((0.007, 0.01))
    far = walk_of(metadata, replace(readings, zero_mm=0.003, warmth_mm=0.004))
    assert far is not None
    assert far.max_mm == pytest.approx(0.02)
    assert walk_of(metadata, replace(readings, drift_mm_per_min=0.0)) is None
    silent = metadata.model_copy(update={"noise": metadata.noise.model_copy(update={"reading_mm": 0.0})})
    assert walk_of(silent, readings) is None


def test_the_noise_of_loads_is_that_within_each() -> None:
    """Of 1, 3 and of 2, 6 the variances are 2 and 8; of 0, 3, 6 it is 9, with twice the weight."""
    assert independent_variance([np.array([1.0, 3.0]), np.array([2.0, 6.0])]) == pytest.approx((5.0, 5.0))
    longer = [np.array([1.0, 3.0]), np.array([2.0, 6.0]), np.array([0.0, 3.0, 6.0])]
    assert independent_variance(longer) == pytest.approx((7.0, 7.0))
