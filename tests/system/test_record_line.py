"""The record of a line whose service is killed again and again: each press is one event, and no sample is lost."""

import json
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from line import Surface
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.programs.forked_line import ForkedLine
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES

pytestmark = pytest.mark.long

PRESSED_S, LIFTED_S = 1.5, 1.0
"""So long that a starved daemon reads some of each."""
KILLS = 2
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
    config.write_text(bench_model.with_suffix(".toml").read_text().replace("rate_hz = 200", "rate_hz = 100"))
    script.write_text(SCRIPT)
    surface = Surface("bench", "modbus-tcp", script, ("--no-ringing",))
    with ForkedLine(tmp_path, SCENES / "bench.toml", bench_model, config, [surface]) as line:

        def answer(path: str) -> dict[str, Any]:
            found: dict[str, Any] = httpx2.get(line.url + path, verify=NO_TLS, timeout=TIMEOUT_S).json()
            return found

        wait_until(lambda: len(answer("/events")["events"]) >= 2)  # the first may have begun before the first sample
        for _ in range(KILLS):
            wait_until(lambda: answer("/contact").get("state") == "contact")
            time.sleep(0.2)
            line.kill_service()
            wait_until(lambda: answer("/contact").get("state") == "clear")
        wait_until(lambda: answer("/contact").get("state") == "contact")  # the end of the daemon cuts this one off
        assert line.end("daemon") == 0
        events = answer("/events?limit=1000")["events"][::-1]
    counts = json.loads(line.summary.read_text())["surfaces"]["bench"]
    assert counts["samples_dropped"] == 0, counts

    whole = events[1:-1]
    assert len(whole) >= KILLS
    assert {(event["kind"], event["begin"], event["end"]) for event in whole} == {("contact", "touch", "lift")}
    touched_s, lifted_s = (np.array([unix_s(event[name]) for event in whole]) for name in ("touched_at", "lifted_at"))
    presses = presses_s(line.truth("bench"))
    within = presses[(presses[:, 1] > touched_s[0]) & (presses[:, 0] < lifted_s[-1])]
    assert len(within) == len(whole), (within, touched_s, lifted_s)
    # A press that is cut in two, or lasts until the next one, sets all later events against other presses.
    found_s, true_s = np.column_stack([touched_s, lifted_s]).ravel(), within.ravel()
    assert np.all(true_s[:-1] < found_s[1:]), (found_s, true_s)
    assert np.all(found_s[:-1] < true_s[1:]), (found_s, true_s)
    # A busy machine reads, or notes the truth, late; not each time.
    assert np.min(np.abs(found_s - true_s)) < 0.05, found_s - true_s


def presses_s(truth: Path) -> Floats:
    """Return when each press began and ended [s], by the rig's own clock, shape (presses, 2)."""
    rows = [line.split(",") for line in truth.read_text(encoding="ascii").splitlines()[1:]]
    times_s, pressed = np.array([float(row[0]) for row in rows]), np.array([bool(row[1]) for row in rows])
    (changes,) = np.nonzero(np.diff(pressed.astype(int)))
    changed_s = times_s[changes + 1]
    if pressed[0]:
        changed_s = changed_s[1:]
    return changed_s[: len(changed_s) // 2 * 2].reshape(-1, 2)


def unix_s(moment: str) -> float:
    return datetime.fromisoformat(moment).timestamp()
