"""A surface at rest costs a few samples a second, and one that is touched has a sample for each reading."""

from __future__ import annotations

import re
import time
from contextlib import closing
from typing import TYPE_CHECKING

import httpx2
import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from example_scenes import SCENES
from free_ports import free_port
from line import Line, Surface, Truth
from plain_http import TIMEOUT_S
from waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.long

SETTLED_S = 2.0
REST_S, TOUCHED_S, TOUCH_S = 9.0, 6.0, 0.1
"""The beam rests, then another load each 0.1 s keeps it from settling."""
SCRIPT = f"[[step]]\nseconds = {REST_S}\n" + "".join(
    f"[[step]]\nseconds = {TOUCH_S}\nposition_mm = {100 + 20 * (number % 10)}\nforce_n = {5 + 10 * (number % 2)}\n"
    for number in range(round(TOUCHED_S / TOUCH_S))
)
SPAN_S, SPANS = 1.0, 3
"""Readings and samples are counted over spans of this time: so many at rest, and so many of a beam that is touched."""


def test_samples_are_few_at_rest_and_all_readings_while_loads_change(bench_model: Path, tmp_path: Path) -> None:
    (tmp_path / "script.toml").write_text(SCRIPT)
    config = tmp_path / "generated.toml"
    port = free_port()
    config.write_text(f"{daemon_config(modelfile.load(bench_model).metadata)}\n[metrics]\nport = {port}\n")
    surface = Surface("bench", "modbus-tcp", tmp_path / "script.toml")
    with (
        Line(tmp_path, SCENES / "bench.toml", bench_model, config, [surface]) as line,
        closing(Truth(line.truth("bench"))) as truth,
    ):

        def counts() -> tuple[float, float]:
            """Return how many samples the daemon has made of how many readings."""
            metrics = httpx2.get(f"http://127.0.0.1:{port}/metrics", trust_env=False, timeout=TIMEOUT_S).text
            found = re.findall(r"^beamtouch_(readings|samples_\w+?)(?:_total)?{.*} (\S+)$", metrics, re.MULTILINE)
            samples = sum(float(value) for name, value in found if name != "readings")
            return samples, float(dict(found)["readings"])

        def touched(begin_s: float, end_s: float) -> set[bool | None]:
            """Return whether something touched at each moment; None where the rig does not say so."""
            loads = [truth.at(moment_s) for moment_s in np.arange(begin_s, end_s, TOUCH_S / 2)]
            return {None if load is None else load[0] is not None for load in loads}

        wait_until(lambda: '"clear"' in httpx2.get(f"{line.url}/contact", trust_env=False, timeout=TIMEOUT_S).text)
        at_rest, changing = list[float](), list[float]()
        while min(len(at_rest), len(changing)) < SPANS:
            begin_s, (samples, readings) = time.time(), counts()
            time.sleep(SPAN_S)
            (samples_after, readings_after), end_s = counts(), time.time()
            share = (samples_after - samples) / max(1.0, readings_after - readings)
            time.sleep(0.05)  # the rig writes the truth every 10 ms
            truth.read()
            if touched(begin_s - SETTLED_S, end_s) == {False}:
                at_rest.append(share)
            elif touched(begin_s, end_s) == {True}:
                changing.append(share)
    # One in 20; more where noise, or a busy machine, has ended a rest for a moment.
    assert 0.01 < min(at_rest) < 0.2, at_rest
    assert min(changing) > 0.9, changing
