"""Processor time of daemon and service per sample, with the growing mean and with a fixed one, on two lines at once."""

import re
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demo"))

import httpx2

from beamtouch_models import modelfile
from beamtouch_models.building.build import build_model
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.progress import silent
from beamtouch_models.scene import parse_scene
from example_scenes import SCENES
from line import Kind, Line, Surface
from processes import processor_s
from waiting import wait_until

LINES: tuple[tuple[Kind, int], ...] = (("modbus-tcp", 200), ("serial", 1000))
"""Transports, and rates in Hz."""
SECONDS = 20.0
SCRIPT = "".join(
    f"[[step]]\nseconds = 0.5\n[[step]]\nseconds = 1.0\nposition_mm = {place}\nforce_n = 8.0\n" for place in (120, 250)
)
GOAL = 1.2


def run() -> list[dict[str, object]]:
    """Measure each transport; contacts of a second follow rests of half a second."""
    rows: list[dict[str, object]] = []
    for kind, rate_hz in LINES:
        text = re.sub(r"rate_hz = \S+", f"rate_hz = {rate_hz}", (SCENES / "bench.toml").read_text())
        with tempfile.TemporaryDirectory() as folder, ExitStack() as lines:
            spent = [lines.enter_context(_line(Path(folder) / name, text, kind, name)) for name in ("growing", "fixed")]
            begun = [_spent(line) for line in spent]
            time.sleep(SECONDS)
            ended = [_spent(line) for line in spent]
        each = [{key: after[key] - before[key] for key in after} for before, after in zip(begun, ended, strict=True)]
        for program in ("daemon", "service"):
            growing, fixed = (one[program] / one["samples"] * 1e6 for one in each)
            rows.append(
                {
                    "name": f"{program}, {kind}, {rate_hz} Hz: growing mean over fixed mean",
                    "value": growing / fixed,
                    "unit": "processor time",
                    "goal": GOAL,
                    "growing, us a sample": growing,
                    "fixed, us a sample": fixed,
                }
            )
    return rows


def _line(folder: Path, text: str, kind: Kind, mean: str) -> Line:
    folder.mkdir()
    names = ("scene.toml", "bench.onnx", "config.toml", "script.toml")
    scene, model, config, script = (folder / name for name in names)
    scene.write_text(text)
    model.write_bytes(
        build_model(parse_scene(text, "bench"), text, "bench", count=None, seed=0, progress=silent).content
    )
    stated = daemon_config(modelfile.load(model).metadata)
    if mean == "fixed":
        stated = re.sub(r"max_mean_ms = .*\n", "", stated.replace('"growing-mean"', '"moving-average"'))
    config.write_text(stated)
    script.write_text(SCRIPT)
    return Line(folder, scene, model, config, [Surface("bench", kind, script, ("--no-ringing",))])


def _spent(line: Line) -> dict[str, float]:
    """Return the processor time so far of daemon and service [s], and the samples that the service took."""
    client = httpx2.Client(base_url=line.url, trust_env=False)
    wait_until(lambda: client.get("/health/ready").is_success, 30)
    pids = line.pids()
    accepted = client.get("/surfaces/bench").json()["samples"]["accepted"]
    return {"samples": accepted} | {name: processor_s(pids[name]) for name in ("daemon", "service")}


if __name__ == "__main__":
    for row in run():
        print(row)
