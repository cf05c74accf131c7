"""The whole line with the MicroPython program in it: a played ADS1115, a real MicroPython, daemon, service."""

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import tomli_w

from beamtouch_models import runtime
from line import Surface
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.programs.forked_line import ForkedLine
from support.programs.micropython_board import ONE_CHIP, Board
from support.running.waiting import wait_until
from support.surfaces.deflections import deflections_of
from support.surfaces.example_scenes import SCENES

VOLTS_PER_COUNT = 4.096 / 2**15
RATE_HZ = 20.0
"""One that a busy machine keeps."""


class BoardLine(ForkedLine):
    """A line whose rig is a board."""

    board: Board

    def _start_rig(self, surface: Surface) -> dict[str, Any]:
        return {"kind": surface.kind, "port": self.board.path}


@pytest.fixture
def configuration(bench_model: Path, tmp_path: Path) -> Path:
    """The daemon's configuration for the bench with a converter of 15 bits instead of 16, at a low rate."""
    config = tomllib.loads(bench_model.with_suffix(".toml").read_text())
    (surface,) = config["surfaces"].values()
    surface["rate_hz"] = RATE_HZ
    for channel in surface["channels"]:
        channel["gain_mm_per_count"] *= 2
        channel["adc_bits"] = 15
    path = tmp_path / "generated.toml"
    path.write_text(tomli_w.dumps(config))
    return path


@pytest.fixture
def volts(bench: runtime.ModelFile, configuration: Path) -> Callable[[float], list[float]]:
    """A function from a force at 120 mm [N] to the voltages of the sensors."""
    ((surface),) = tomllib.loads(configuration.read_text())["surfaces"].values()

    def at(force_n: float) -> list[float]:
        (deflection_mm,) = deflections_of(bench, np.array([120.0]), np.array([force_n]))
        return [
            (channel["rest_gap_mm"] - moved_mm - channel["offset_mm"]) / channel["gain_mm_per_count"] * VOLTS_PER_COUNT
            for channel, moved_mm in zip(surface["channels"], deflection_mm, strict=True)
        ]

    return at


@pytest.fixture
def board(tmp_path: Path, volts: Callable[[float], list[float]]) -> Iterator[Board]:
    """A board with the bench at rest, whose sensors have 3 µm of noise."""
    board = Board(tmp_path, ONE_CHIP, volts(0.0), noise_v=0.003 / (2 * 5.722e-5) * VOLTS_PER_COUNT)
    yield board
    board.unplug()


def test_a_touch_is_found_through_the_board(
    board: Board, volts: Callable[[float], list[float]], configuration: Path, bench_model: Path, tmp_path: Path
) -> None:
    line = BoardLine(tmp_path, SCENES / "bench.toml", bench_model, configuration, [Surface("bench", "serial")])
    line.board = board
    with line:
        contact: dict[str, Any] = {}

        def is_in(state: str) -> bool:
            contact.update(httpx2.get(f"{line.url}/contact", verify=NO_TLS, timeout=TIMEOUT_S).json())
            return contact.get("state") == state and "unsteady" not in contact["notes"]

        wait_until(lambda: is_in("clear"), pause_s=0.1)
        board.put(volts(10.0))
        wait_until(lambda: is_in("contact"), pause_s=0.1)
        assert contact["position_mm"] == pytest.approx(120, abs=15)
        assert contact["force_n"] == pytest.approx(10, rel=0.15)
        board.put(volts(0.0))
        wait_until(lambda: is_in("clear"), pause_s=0.1)
        assert line.dead() == []
