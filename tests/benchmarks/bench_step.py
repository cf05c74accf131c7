"""From a step at the device to the contact over HTTP, beside what sampling and filter need for it by themselves.

`make bench` takes some steps; `python tests/benchmarks/bench_step.py --steps 1000 [--batch-ms 1]` as many.
"""

import argparse
import asyncio
import http.client
import json
import sys
import tempfile
import tomllib
from pathlib import Path
from time import monotonic

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
import tomli_w
from serving import service, surfaces
from shipped import build

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models import runtime
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.loads import Load
from beamtouch_models.lab.rig.surface import VirtualSurface
from beamtouch_models.runtime import State
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.surface import Surface as Served
from daemon.devices import pymodbus_server
from daemon.process import started
from support.surfaces.example_scenes import SCENES

STEPS = 150
LOAD = Load(150.0, 10.0)
REST = Load(None, 0.0)
LIFTED_S = 0.1


def run(steps: int = STEPS, batch_ms: float | None = None) -> list[dict[str, object]]:
    """Step so often; the daemon collects samples for as long as it does by default, or for `batch_ms`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = build(folder)
        with service(folder, surfaces(["bench"])) as (_, port):
            delays_s, needed = asyncio.run(stepped(folder, model, port, steps, batch_ms))
    period_ms = 1e3 / model.metadata.sensor.rate_hz
    rows: list[dict[str, object]] = []
    for quantile in (50, 99):
        alone_ms = (quantile / 100 + needed - 1) * period_ms  # until the next reading, and the further ones it takes
        value = float(np.percentile(delays_s, quantile)) * 1e3
        rows.append(
            {
                "name": f"step at the device to contact over HTTP, p{quantile} of {steps}",
                "value": value,
                "unit": "ms",
                "sampling and filter alone, ms": alone_ms,
                "above it, ms": value - alone_ms,
                "goal": "at most 5 ms above at p99" if quantile == 99 else None,
            }
        )
    return rows


async def stepped(
    folder: Path, model: runtime.ModelFile, port: int, steps: int, batch_ms: float | None
) -> tuple[list[float], int]:
    """Run the daemon, and be the device; return the delays [s], and how many readings a contact needs."""
    scene, _ = load_scene(SCENES / "bench.toml")
    beam, load = VirtualSurface(scene, model.metadata, seed=1, rings=False), REST

    async def convert(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[:4] = beam.counts(load, 0.0)

    async with pymodbus_server([0] * 4, convert) as device:
        config = tomllib.loads((folder / "generated.toml").read_text())
        config["publish"] |= {"url": f"http://127.0.0.1:{port}", "token_file": "token"} | (
            {"batch_ms": batch_ms} if batch_ms else {}
        )
        (surface,) = config["surfaces"].values()
        surface["source"] = {"kind": "modbus-tcp", "host": "127.0.0.1", "port": device}
        (folder / "daemon.toml").write_text(tomli_w.dumps(config))
        async with started("run", folder / "daemon.toml"):
            await asyncio.to_thread(wait_for, port, "clear")
            delays_s = []
            for _ in range(steps):
                await asyncio.sleep(LIFTED_S + float(np.random.default_rng().uniform(0, 0.02)))
                begin_s, load = monotonic(), LOAD
                delays_s.append(await asyncio.to_thread(wait_for, port, "contact") - begin_s)
                load = REST
                await asyncio.to_thread(wait_for, port, "clear")
    return delays_s, readings_needed(Surface.model_validate(surface), beam, model)


def wait_for(port: int, state: str) -> float:
    """Ask until the contact has a state; return when it had [s, monotonic]."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    try:
        while True:
            connection.request("GET", "/contact")
            answer = connection.getresponse()
            body = json.loads(answer.read())
            if body.get("state") == state:
                return monotonic()
    finally:
        connection.close()


def readings_needed(settings: Surface, beam: VirtualSurface, model: runtime.ModelFile) -> int:
    """Return after how many readings of a load its filtered samples are a contact to the model."""
    pipeline, period_s, surface = Pipeline(settings), 1 / settings.rate_hz, Served("bench", model)
    pipeline.process([Reading(n * period_s, tuple(beam.counts(REST, 0.0))) for n in range(20)], 0.0)
    for count in range(1, 50):
        counts = tuple(beam.counts(LOAD, 0.0))
        (taken,) = pipeline.process([Reading((19 + count) * period_s, counts)], 0.0)
        batch = Batch(boot_id="boot-0001", channels=model.channels, newest_age_ms=0.0, samples=[taken.sample])
        surface.receive(batch, count * period_s)
        if surface.view(count * period_s).state is State.CONTACT:
            return count
    raise AssertionError("the load is no contact")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--batch-ms", type=float)
    options = parser.parse_args()
    for row in run(options.steps, options.batch_ms):
        print(row)
