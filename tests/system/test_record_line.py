"""The record of a line whose service is killed again and again: each press is one event, and no sample is lost."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import httpx2
import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from example_scenes import SCENES
from line import Line, Surface
from plain_http import NO_TLS, TIMEOUT_S
from waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.long

PRESSED_S, LIFTED_S = 0.6, 0.5
KILLS = 6
SCRIPT = f"""
[[step]]
seconds = {LIFTED_S}
[[step]]
seconds = {PRESSED_S}
position_mm = 120
force_n = 12
"""


def test_each_press_is_one_event_whatever_happens_to_the_service(tmp_path: Path, bench_model: Path) -> None:
    config, script = tmp_path / "built.toml", tmp_path / "script.toml"
    config.write_text(daemon_config(modelfile.load(bench_model).metadata))
    script.write_text(SCRIPT)
    surface = Surface("bench", "modbus-tcp", script, ("--no-ringing",))
    with Line(tmp_path, SCENES / "bench.toml", bench_model, config, [surface]) as line:

        def answer(path: str) -> dict[str, Any]:
            found: dict[str, Any] = httpx2.get(line.url + path, verify=NO_TLS, timeout=TIMEOUT_S).json()
            return found

        wait_until(lambda: len(answer("/events")["events"]) >= 2)
        for _ in range(KILLS):
            wait_until(lambda: answer("/contact").get("state") == "contact")
            time.sleep(0.2)
            line.kill_service()
            wait_until(lambda: "state" in answer("/contact"))
        wait_until(lambda: answer("/contact").get("state") == "clear")
        assert line.end("daemon") == 0
        events = answer("/events?limit=1000")["events"][::-1]
    counts = json.loads(line.summary.read_text())["surfaces"]["bench"]
    assert counts["samples_dropped"] == 0, counts

    # The script begins anew now and then, and the rig may be late; a press that is cut in two is much shorter.
    whole = events[1:-1]
    assert len(whole) >= KILLS
    assert {(event["kind"], event["begin"], event["end"]) for event in whole} == {("contact", "touch", "lift")}
    dwells_ms = np.array([event["dwell_ms"] for event in whole])
    assert np.all(np.abs(dwells_ms - 1e3 * PRESSED_S) < 150), dwells_ms
