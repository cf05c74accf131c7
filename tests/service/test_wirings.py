"""Swapped cables and inverted sensors, as the service tells them after some contacts."""

from __future__ import annotations

import logging
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface

from .touches import Touches

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from beamtouch_models.arrays import Floats
    from service.conftest import Bench

BEGIN = datetime(2026, 11, 23, 12, 0, tzinfo=UTC)
TOUCHES = 12


class Line:
    """A surface that is touched, and whose deflections a test may change on their way."""

    def __init__(self, bench: Bench, model: modelfile.ModelFile) -> None:
        self.bench, self._touches, self._begin = bench, Touches(model), BEGIN

    def touch(self, change: Callable[[Floats], Floats], count: int = TOUCHES) -> str | None:
        """Touch some times; returns the wiring that the service names then."""
        batch: dict[str, Any] = self._touches.batch(count, self._begin, every_s=2.0)
        for sample in batch["samples"]:
            sample["deflection_mm"] = change(np.array(sample["deflection_mm"])).tolist()
        self._begin += timedelta(seconds=2.0 * count)
        self.bench.now_s += 2.0 * count
        assert self.bench.post(batch).status_code == 200
        wiring: str | None = self.bench.get("/surfaces/press-7").json()["wiring"]
        return wiring


@pytest.fixture
def line(make_bench: type[Bench], bench_model: Path) -> Line:
    model = modelfile.load(bench_model)
    return Line(make_bench(Surface("press-7", model)), model)


def as_it_is(deflection_mm: Floats) -> Floats:
    return deflection_mm


@pytest.mark.parametrize(
    ("change", "wiring"),
    [
        (lambda one: one[[1, 0, 2, 3]], "s1 and s2 seem to be swapped"),
        (lambda one: one[[0, 3, 2, 1]], "s2 and s4 seem to be swapped"),
        (lambda one: one * [1, 1, -1, 1], "s3 seems to be inverted"),
    ],
)
def test_a_wrong_wiring_is_named_after_some_contacts_and_is_over_once_it_is_right(
    line: Line, change: Callable[[Floats], Floats], wiring: str, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "beamtouch.service")
    assert line.touch(change, count=2) is None
    assert line.touch(change) == wiring
    assert line.touch(as_it_is) is None
    named, over = (text for text in caplog.messages if "wiring" in text)
    assert named.startswith(f"surface press-7: {wiring}; that explains its last contacts; check the wiring")
    assert over == "surface press-7: the wiring seems to be right again"


def test_other_faults_are_not_taken_for_a_wrong_wiring(line: Line) -> None:
    assert line.touch(as_it_is) is None
    assert line.touch(lambda one: one * [1, 0, 1, 1]) is None  # one that does not move
    assert line.touch(lambda one: one * [1, 0.6, 1, 1]) is None
    again = line.touch(lambda one: one + one[::-1])  # as heavy a load at the other end
    assert again is None
