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
from shipped import build

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models import modelfile
from beamtouch_models.modelfile import State
from beamtouch_models.rig.loads import Load
from beamtouch_models.rig.surface import VirtualSurface
from beamtouch_models.scene import load_scene
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.surface import Surface as Served
from daemon.devices import pymodbus_server
from daemon.process import started
from example_scenes import SCENES

STEPS = 150
LOAD = Load(150.0, 10.0)
REST = Load(None, 0.0)
LIFTED_S = 0.1
TOKEN = "a-token-of-this-benchmark"  # noqa: S105


def run(steps: int = STEPS, batch_ms: float | None = None) -> list[dict[str, object]]:
    """Step so often; the daemon collects samples for as long as it does by default, or for `batch_ms`."""
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(stepped(Path(folder), steps, batch_ms))


async def stepped(folder: Path, steps: int, batch_ms: float | None) -> list[dict[str, object]]:
    """Run service and daemon as processes, and be the device."""
    (scene, _), model = load_scene(SCENES / "bench.toml"), build(folder)
    path, token = folder / "bench.onnx", folder / "token"
    token.write_text(TOKEN)
    beam, touching, changed_s = VirtualSurface(scene, model.metadata, seed=1, rings=False), [False], [0.0]

    async def convert(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[:4] = beam.counts(LOAD if touching[0] else REST, 0.0)

    async with pymodbus_server([0] * 4, convert) as device:
        arguments = ("-m", "beamtouch_service.cli", "run", "--port", "0", "--model", path, "--write-token-file", token)
        pipe = asyncio.subprocess.PIPE
        service = await asyncio.create_subprocess_exec(sys.executable, *map(str, arguments), stdout=pipe)
        assert service.stdout is not None
        port = int((await service.stdout.readline()).decode().rpartition(":")[2])
        config = tomllib.loads((folder / "generated.toml").read_text())
        config["publish"] |= {"url": f"http://127.0.0.1:{port}", "token_file": str(token)} | (
            {"batch_ms": batch_ms} if batch_ms else {}
        )
        (surface,) = config["surfaces"].values()
        surface["source"] = {"kind": "modbus-tcp", "host": "127.0.0.1", "port": device}
        (folder / "daemon.toml").write_text(tomli_w.dumps(config))
        needed = readings_needed(Surface.model_validate(surface), beam, model)
        async with started("run", folder / "daemon.toml"):
            await asyncio.to_thread(wait_for, port, "clear")
            delays_s = []
            for _ in range(steps):
                await asyncio.sleep(LIFTED_S + float(np.random.default_rng().uniform(0, 0.02)))
                changed_s[0], touching[0] = monotonic(), True
                delays_s.append(await asyncio.to_thread(wait_for, port, "contact") - changed_s[0])
                touching[0] = False
                await asyncio.to_thread(wait_for, port, "clear")
        service.terminate()
        await service.wait()
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


def readings_needed(settings: Surface, beam: VirtualSurface, model: modelfile.ModelFile) -> int:
    """Return after how many readings of a load its filtered samples are a contact to the model."""
    pipeline, period_s, surface = Pipeline(settings), 1 / settings.rate_hz, Served("bench", model)
    pipeline.process([Reading(n * period_s, tuple(beam.counts(REST, 0.0))) for n in range(20)], 0.0)
    for count in range(1, 50):
        counts = tuple(beam.counts(LOAD, 0.0))
        (taken,) = pipeline.process([Reading((19 + count) * period_s, counts)], 0.0)
        batch = Batch(boot_id="boot-0001", channels=model.channels, newest_age_ms=0.0, samples=[taken.sample])
        surface.receive(batch, count * period_s)
        if surface.contact(count * period_s).state is State.CONTACT:
            return count
    raise AssertionError("the load is no contact")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--batch-ms", type=float)
    options = parser.parse_args()
    for row in run(options.steps, options.batch_ms):
        print(row)
