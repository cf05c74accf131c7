"""What `design-sensors place` says of layouts whose figures are known."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.compared import ALL_WORK, EQUAL, PAPERS, TAKEN, Compared
from beamtouch_models.design.layout import Layout, keep_sensors
from beamtouch_models.design.placement.placing import Aim
from beamtouch_models.design.placement.reasons import Costs
from beamtouch_models.design.surface import Surface
from beamtouch_models.places import Extent, on_axis
from support.programs.in_process import Command, Outcome
from support.surfaces.example_scenes import PAPER

POSITIONS_MM = (60.0, 200.0, 341.5)


def costs(all_mm: float, *failed_mm: float) -> Costs:
    """Return errors that are the same everywhere."""
    at_mm = on_axis(np.linspace(5.0, 395.0, 40))
    without_mm = np.reshape([[error] * 40 for error in failed_mm], (-1, 40))
    return Costs(on_axis(np.array(POSITIONS_MM)), Extent.of_beam((0.0, 400.0)), at_mm, np.full(40, 10.0),
                 np.full(40, all_mm), without_mm)  # fmt: skip


OTHERS_MM = {
    TAKEN: np.array(POSITIONS_MM),
    PAPERS: np.array([70.04, 200.0, 329.96]),
    EQUAL: np.array([100.0, 200.0, 300.0]),
    ALL_WORK: np.array([90.25, 200.0, 310.0]),
}
COMPARED = Compared(
    OTHERS_MM,
    {TAKEN: costs(4.0, 9.0, 7.0, 8.0), PAPERS: costs(5.25, 8.5, 8.0, 7.5), ALL_WORK: costs(3.0, 12.0, 11.0, 10.0)},
    ("the first", "the second", "the third"),
)
LIMIT, WITHOUT = Measurement(3.075, 0.1), (Measurement(5.0, 0.2), Measurement(6.25, 0.3), Measurement(7.5, 0.25))


@dataclass
class Known:
    """Figures that stand for those that are measured, and what was asked for them."""

    limit: Measurement = LIMIT
    without: tuple[Measurement, ...] = WITHOUT
    compared: Compared = COMPARED
    gap: float = 0.0123
    log_product: float = -74.90654
    asked: dict[str, Any] = field(default_factory=dict)


Told = Callable[..., Outcome]


@pytest.fixture
def told(design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Told:
    """Runs the command on the paper's beam with three sensors, as if all of this had been found."""

    def run(known: Known, *options: object) -> Outcome:
        def place(surface: Surface, *, count: int | None, seed: int, aim: Aim, progress: object) -> Layout:  # noqa: ARG001
            known.asked |= {"count": count, "seed": seed, "aim": aim}
            layout = keep_sensors(surface, POSITIONS_MM, aim)
            score = known.log_product
            return replace(layout, placement=replace(layout.placement, log_eigenvalue_product=score, evaluations=321))

        def limit(_prior: object, draws: int, seed: int) -> Measurement:
            known.asked |= {"draws": draws, "limit seed": seed}
            return known.limit

        def failed(_prior: object, given: Measurement, seed: int, _effort: object) -> list[Measurement]:
            assert given is known.limit
            known.asked["failed seed"] = seed
            return list(known.without)

        def bound(_influence: object, _rules: object, positions_mm: Floats, leading: int | None) -> float:
            known.asked |= {"bound": positions_mm.tolist(), "leading": leading}
            return known.gap

        for name, found in (
            ("place_sensors", place), ("accuracy_limit", limit), ("limits_with_one_failed", failed),
            ("compare_layout", lambda *_: known.compared), ("largest_gap", bound),
        ):  # fmt: skip
            monkeypatch.setattr(f"beamtouch_models.commands.place.{name}", found)
        path = tmp_path / "scene.toml"
        path.write_text(PAPER.replace("count = 2", "count = 3\nsize_mm = 8\nrate_hz = 100").replace(
            "noise_percent_of_max = 2", "noise_mm = 0.006\n[requirements]\nlatency_ms = 40"))  # fmt: skip
        done = design_sensors_here("place", path, *options)
        assert done.returncode == 0, done.stderr
        return done

    return run


def rows(done: Outcome) -> dict[str, str]:
    """Return the printed lines by the word before them, each in one line."""
    found, last = dict[str, str](), ""
    for line in done.stdout.splitlines():
        words = line.split()
        if not line.startswith(" "):
            last = words.pop(0)
        found[last] = " ".join([*found.get(last, "").split(), *words])
    return found


def test_sensors_and_limits_are_in_mm_of_which_a_hundredth_of_the_length_is_a_percent(told: Told) -> None:
    known = Known()
    said = rows(told(known, "--seed", 5))
    assert said["sensors"] == "60, 200, 341.5 mm from the left end"
    # Four readings within the latency: 6 um over the root of 4.
    assert said["limit"] == (
        "mean error 12.3 +- 0.4 mm (3.1 % of the length), the best possible with these sensors, at 3 um noise per "
        "sample"
    )
    assert said["failed"] == (
        "mean error without the sensor at 60 mm: 20.0 +- 0.8 mm; at 200 mm: 25 +- 1 mm; at 341.5 mm: 30 +- 1 mm"
    )
    assert [said[name] for name in ("s1", "s2", "s3")] == ["the first", "the second", "the third"]
    assert known.asked["aim"].failed_percent is None  # the usual one
    numbers = {name: known.asked[name] for name in ("count", "seed", "draws", "limit seed", "failed seed")}
    assert numbers == {"count": None, "seed": 5, "draws": 10_000, "limit seed": 6, "failed seed": 6}


def test_other_layouts_are_told_to_a_tenth_of_a_millimetre_with_what_they_cost(told: Told) -> None:
    said = rows(told(Known()))
    assert said["error"].startswith("mean 4 mm, 4 mm over the inner 90 %, 4 mm over the outer 5 % at each end; 9 mm ")
    assert said["papers"].startswith("70, 200, 330 mm: mean 5.25 mm")
    assert "equal" not in said  # it was not measured
    assert said["instead"].startswith("90.25, 200, 310 mm would err 25 % less, 3 mm, while all sensors work, and 12 mm")
    alone = replace(COMPARED, costs={TAKEN: costs(4.0, 9.0, 7.0, 8.0), EQUAL: costs(6.0)})
    said = rows(told(Known(compared=alone, without=())))
    assert {"instead", "papers", "failed"}.isdisjoint(said)
    assert said["equal"].startswith("100, 200, 300 mm: mean 6 mm")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ("--seed", 7),
            "the least position error, with the worst sensor failed 10 % of the time; search exchange, seed 7",
        ),
        (("--failed-percent", 0), "the least position error; search exchange, seed 0"),
        (
            ("--components", 2, "--search", "paper"),
            "the largest product of eigenvalues, as in the paper; search paper, seed 0",
        ),
    ],
)
def test_the_goal_of_the_search_is_told(told: Told, options: tuple[object, ...], words: str) -> None:
    assert rows(told(Known(), *options))["placed"] == f"for {words}"


@pytest.mark.parametrize(
    ("components", "gap", "log_product", "product", "bound"),
    [
        (2, 0.01234, -74.90654, "-74.9065: the logarithm of the product of the 2 leading eigenvalues", "0.0123 above"),
        (
            3,
            0.0,
            -52.0,
            "-52.0000: the logarithm of the product of all eigenvalues",
            "no layout on the grid has a",
        ),
        (
            None,
            0.5,
            -np.inf,
            "-inf, as a component is below rounding: the logarithm of the product of",
            "0.5 above",
        ),
    ],
)
def test_a_product_of_eigenvalues_is_told_with_its_bound(
    told: Told, components: int | None, gap: float, log_product: float, product: str, bound: str
) -> None:
    options = ("--criterion", "eigenvalue-product") if components is None else ("--components", components)
    known = Known(gap=gap, log_product=log_product)
    said = rows(told(known, *options))
    assert said["product"].startswith(f"ln {product}")
    assert bound in said["bound"]
    assert (known.asked["bound"], known.asked["leading"]) == (list(POSITIONS_MM), components)


def test_a_paper_needs_two_sensors_and_lines_without_a_bound_are_those_of_the_other_criterion(told: Told) -> None:
    said = rows(told(Known()))
    assert {"product", "bound"}.isdisjoint(said)
    assert said["paper"].startswith(f"{recommended()} sensors by the paper's rule")


def recommended() -> int:
    """Return how many eigenvalues of the paper's eight sensors are above the square of a sample's noise of 3 um."""
    x, a = np.arange(1, 9)[None, :] / 9, np.arange(1.0, 400.0)[:, None] / 400
    unit_mm = 10 * 400**3 / (210e3 * 25 * 3**3 / 12)
    matrix = -((2 - a) * (a - 1) * a * x + (1 - a) * x**3 - np.maximum(x - a, 0) ** 3) / 6 * unit_mm
    return max(2, int((np.linalg.eigvalsh(matrix.T @ matrix / 399) > 0.003**2).sum()))


def test_fields_have_all_that_is_printed(told: Told) -> None:
    found = json.loads(told(Known(), "--components", 2, "--seed", 4, "--json").stdout)
    assert found["positions_mm"] == list(POSITIONS_MM)
    assert (found["accuracy_limit_percent"], found["standard_error"]) == (3.075, 0.1)
    assert (found["limit_without_percent"], found["limit_without_standard_error"]) == (
        [5.0, 6.25, 7.5],
        [0.2, 0.3, 0.25],
    )
    assert (found["log_eigenvalue_product"], found["gap"], found["evaluations"]) == (-74.90654, 0.0123, 321)
    assert (found["components"], found["search"], found["seed"]) == (2, "exchange", 4)
    taken, papers, _ = found["compared"]
    assert taken == {
        "layout": "this layout", "positions_mm": list(POSITIONS_MM), "error_mm": 4.0, "inner_mm": 4.0, "ends_mm": 4.0,
        "failed_mm": [9.0, 7.0, 8.0],
    }  # fmt: skip
    assert papers["positions_mm"] == [70.04, 200.0, 329.96]
    plain = json.loads(told(Known(log_product=-np.inf), "--json").stdout)
    assert (plain["log_eigenvalue_product"], plain["gap"], plain["components"]) == (None, None, 3)
    assert plain["reasons"] == ["the first", "the second", "the third"]
