"""The whole line with the real firmware in it: rig, simulated chip, daemon, service."""

from pathlib import Path
from typing import Any

import httpx2
import pytest

from line import Surface
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.programs.forked_line import ForkedLine
from support.programs.simulated_board import Board
from support.running.waiting import wait_until

SCRIPT = "repeat = false\n[[step]]\nseconds = 1e6\nposition_mm = 120\nforce_n = 10\n"


def test_a_touch_is_found_through_the_firmware(board: Board, ten_bits: tuple[Path, Path], tmp_path: Path) -> None:
    scene, model = ten_bits
    (tmp_path / "script.toml").write_text(SCRIPT)
    surface = Surface("bench", "serial", tmp_path / "script.toml", ("--firmware", *board.command))
    with ForkedLine(tmp_path, scene, model, model.with_suffix(".toml"), [surface]) as line:
        contact: dict[str, Any] = {}

        def rests() -> bool:
            """Return whether there is a contact, and its readings do not move any more."""
            contact.update(httpx2.get(f"{line.url}/contact", verify=NO_TLS, timeout=TIMEOUT_S).json())
            return contact.get("state") == "contact" and "unsteady" not in contact["notes"]

        wait_until(rests, pause_s=0.1)
        assert contact["position_mm"] == pytest.approx(120, abs=15)
        assert contact["force_n"] == pytest.approx(10, rel=0.3)
        assert line.dead() == []
        assert line.end("rig-bench") == 0
    assert not (tmp_path / "bench.line").is_symlink()
