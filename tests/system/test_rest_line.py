"""A surface at rest costs a few samples a second, and one that is touched has a sample for each reading."""

from __future__ import annotations

import re
import time
from typing import TYPE_CHECKING

import httpx2
import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from example_scenes import SCENES
from free_ports import free_port
from line import Line, Surface
from plain_http import TIMEOUT_S
from waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.long

SETTLED_S = 2.0
REST_S, TOUCHED_S, TOUCH_S = 20.0, 8.0, 0.1
"""The beam rests, then another load each 0.1 s keeps it from settling."""
SCRIPT = f"[[step]]\nseconds = {REST_S}\n" + "".join(
    f"[[step]]\nseconds = {TOUCH_S}\nposition_mm = {100 + 20 * (number % 10)}\nforce_n = {5 + 10 * (number % 2)}\n"
    for number in range(round(TOUCHED_S / TOUCH_S))
)


def test_samples_are_few_at_rest_and_all_readings_while_loads_change(bench_model: Path, tmp_path: Path) -> None:
    (tmp_path / "script.toml").write_text(SCRIPT)
    config = tmp_path / "generated.toml"
    port = free_port()
    config.write_text(f"{daemon_config(modelfile.load(bench_model).metadata)}\n[metrics]\nport = {port}\n")
    surface = Surface("bench", "modbus-tcp", tmp_path / "script.toml")
    with (
        Line(tmp_path, SCENES / "bench.toml", bench_model, config, [surface]) as line,
        httpx2.Client(base_url=line.url, timeout=TIMEOUT_S) as client,
    ):

        def state() -> str | None:
            response = client.get("/contact")
            return str(response.json()["state"]) if response.is_success else None

        def counts() -> tuple[int, float]:
            metrics = httpx2.get(f"http://127.0.0.1:{port}/metrics", trust_env=False, timeout=TIMEOUT_S).text
            (readings,) = re.findall(r'^beamtouch_readings_total{surface="bench"} (\S+)$', metrics, re.MULTILINE)
            return int(client.get("/surfaces/bench").json()["samples"]["accepted"]), float(readings)

        def samples_per_reading(seconds: float) -> float:
            samples, readings = counts()
            time.sleep(seconds)
            samples_after, readings_after = counts()
            return (samples_after - samples) / (readings_after - readings)

        wait_until(lambda: state() == "clear", 30)
        time.sleep(SETTLED_S)
        at_rest = samples_per_reading(5.0)
        wait_until(lambda: state() == "contact", 60)
        changing = samples_per_reading(5.0)
    # One in 20, and all of a rest that noise, or a busy machine, has ended for a moment.
    assert 0.01 < at_rest < 0.5
    assert changing > 0.9
