"""What the marks of a commissioning count for: a step that was skipped, or pressed elsewhere, is none that passed."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamtouch_models import runtime
from beamtouch_models.runtime import InfluenceCurve
from service.bench import START_US, TOKEN, Bench, surface_with

PATH = "/surfaces/press-7/commissioning"
FORCE_N = 8.0
STEP_US, SECOND = 10_000, 105
"""Time between two samples, and samples that last a little longer than a press must be held."""
PASSED = "Every sensor moves as it should, and the surface finds each mark."


class Commissioning:
    """A commissioning of the bench, all of whose sensors work."""

    def __init__(self, model: Path) -> None:
        loaded = runtime.load(model)
        self.bench = Bench(surface_with(loaded))
        self._curve, self._sent = InfluenceCurve.of(loaded.metadata), 0
        self.sensors = len(loaded.channels)

    def follow(self, *, skipped: int | None = None, off_mm: Mapping[int, float] | None = None) -> dict[str, Any]:
        """Press as asked, but skip one step, and press some so far from the asked place; return the report."""
        self._send(0.0, 0.0)
        begun = self.bench.post(b"", PATH, TOKEN).json()["run"]
        self._send(0.0, 0.0)
        for step in range(begun["steps"]):
            now = self._now
            assert now["step"] == step
            if step == skipped:
                answer = self.bench.post(b"", f"{PATH}/skip?run={begun['id']}&step={step}", TOKEN)
                assert answer.status_code == 200
                self._send(0.0, 0.0)
            else:
                at_mm = now["at_mm"]["position"] + (off_mm or {}).get(step, 0.0)
                self._send(at_mm, FORCE_N)
                self._send(0.0, 0.0)
        report: dict[str, Any] = self._now["report"]
        answer = self.bench.post(b"", f"{PATH}/confirm?run={begun['id']}&by=Ann", TOKEN)
        assert answer.json()["passed"] == report["passed"]
        text = self.bench.get(f"{PATH}s/1?format=text").text
        assert ("NOT PASSED" in text) != report["passed"]
        return report

    @property
    def _now(self) -> dict[str, Any]:
        found: dict[str, Any] = self.bench.get(PATH).json()["run"]
        return found

    def _send(self, at_mm: float, force_n: float) -> None:
        """Send a second of samples under a load."""
        row = (force_n * self._curve.at(np.array([[at_mm]]))[0][0]).tolist()
        begin_us = START_US + STEP_US * self._sent
        self.bench.send(*[row] * SECOND, sequence=self._sent + 1, begin_us=begin_us, every_us=STEP_US)
        self._sent += SECOND


@pytest.fixture
def commissioning(bench_model: Path) -> Commissioning:
    return Commissioning(bench_model)


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "an error passes up to 5 mm, for your aim, and half the interval",
)
def test_presses_as_asked_pass(commissioning: Commissioning) -> None:
    report = commissioning.follow()
    assert report["passed"]
    assert report["verdict"][0] == PASSED
    assert all(place["says"].endswith(" mm") and ", within " in place["says"] for place in report["places"])


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    (
        "If the page does not see a press, make sure that you press firmly, then press Not seen: go on. The result "
        "says so."
    ),
)
@pytest.mark.parametrize("mark", [0, 2])
def test_a_mark_that_was_skipped_does_not_pass(commissioning: Commissioning, mark: int) -> None:
    report = commissioning.follow(skipped=commissioning.sensors + mark)
    assert not report["passed"]
    assert PASSED not in report["verdict"]
    assert report["places"][mark]["says"] == "the press was not seen"
    at_mm = report["places"][mark]["at_mm"]["position"]
    assert f"At {at_mm:g} mm: the press was not seen." in report["verdict"]


def test_a_sensor_that_was_skipped_does_not_pass(commissioning: Commissioning) -> None:
    report = commissioning.follow(skipped=1)
    assert not report["passed"]
    assert PASSED not in report["verdict"]


@pytest.mark.parametrize("off_mm", [-50.0, 50.0])
def test_a_mark_that_is_found_elsewhere_does_not_pass_on_either_side(
    commissioning: Commissioning, off_mm: float
) -> None:
    report = commissioning.follow(off_mm={commissioning.sensors + 1: off_mm})
    place = report["places"][1]
    error_mm, allowed_mm = place["error_mm"]["position"], place["allowed_mm"]["position"]
    assert error_mm == pytest.approx(off_mm, abs=3.0)
    assert allowed_mm < 20.0
    assert place["says"] == f"{error_mm:+.1f} mm, more than {allowed_mm:.1f} mm"
    assert not report["passed"]
    assert PASSED not in report["verdict"]
    assert f"The largest error of a position is {abs(error_mm):.1f} mm." in report["verdict"]
