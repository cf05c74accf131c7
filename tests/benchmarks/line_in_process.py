"""One surface of the scene `bench` in this process: its readings, the daemon's samples of them, and the contacts."""

import asyncio
import sys
from pathlib import Path
from time import thread_time
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from shipped import build

from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models import modelfile
from beamtouch_models.physics.beam import influence_matrix
from beamtouch_models.scene import load_scene
from beamtouch_service.api.app import Application, create_app
from beamtouch_service.api.samples import parse_batch
from beamtouch_service.samples import Batch
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.surface import Surface

RATES = {1000: 4, 200: 1}
"""Rate in Hz -> samples in a batch of the daemon, which sends every 4 ms."""
SECONDS = 2
TOKEN = "a-token-of-this-benchmark"  # noqa: S105


class Line:
    """One surface: its readings, and the batches that become of them."""

    def __init__(self, folder: Path, rate_hz: int) -> None:
        self._rate_hz, self._in_batch, own = rate_hz, RATES[rate_hz], folder / str(rate_hz)
        own.mkdir()
        self._metadata = build(own, rate_hz=rate_hz).metadata
        self._scene, _ = load_scene(own / "bench.toml")
        self._model, self._config = own / "bench.onnx", own / "generated.toml"

    def readings(self, course: str) -> list[Reading]:
        """Return readings with noise; half a second of rest, then the course."""
        time_s = np.arange(SECONDS * self._rate_hz) / self._rate_hz
        force_n = np.where(time_s < 0.5, 0.0, 0.0 if course == "clear" else 8.0)
        position_mm = 200 + 120 * np.sin(np.pi * time_s / 2) * (course == "moving load")
        said, sensor = self._metadata, self._metadata.sensor
        sensor_mm = np.array([channel.position_mm for channel in said.layout])
        deflection_mm = force_n[:, None] * influence_matrix(self._scene, sensor_mm, position_mm)
        noise = np.random.default_rng(0).normal(scale=said.noise.reading_mm, size=deflection_mm.shape)
        gap_mm = sensor.standoff_mm - deflection_mm - noise
        counts = np.round((gap_mm - sensor.offset_mm) / sensor.gain_mm_per_count).tolist()
        return [Reading(100.0 + at_s, tuple(row), 0) for at_s, row in zip(time_s.tolist(), counts, strict=True)]

    def daemon(self, course: str, in_piece: int) -> tuple[float, list[bytes]]:
        """Return the processor time for a sample [us] of pieces of so many readings, and the batches."""
        surface, readings = load_config(self._config).surfaces["bench"], self.readings(course)
        pipeline, took_s, taken = Pipeline(surface), [], []
        for start in range(0, len(readings), in_piece):
            begin_s = thread_time()
            taken += pipeline.process(readings[start : start + in_piece], 1.7e9)
            took_s.append(thread_time() - begin_s)
        batches = [
            Batch(
                boot_id="benchmark-1",
                channels=surface.channel_names,
                newest_age_ms=1.5,
                samples=[one.sample for one in taken[start : start + self._in_batch]],
                noise_mm=[surface.noise_mm or 0.0] * len(surface.channels),
            )
            for start in range(0, len(taken), self._in_batch)
        ]
        return median_us(took_s) / in_piece, [
            batch.model_dump_json(exclude_defaults=True).encode() for batch in batches
        ]

    def service(self, batches: list[bytes]) -> tuple[float, float, list[bytes]]:
        """Return the processor time for a sample [us] without HTTP, and as requests without sockets; the contacts."""
        taken, posted, contacts = list[float](), list[float](), list[bytes]()
        surface, app = self._served()
        with asyncio.Runner() as runner:
            for number, body in enumerate(batches):
                now_s = 100.0 + number * 0.004
                begin_s = thread_time()
                batch = parse_batch(body)
                recording = app.context.recorder.take(surface, batch, surface.receive(batch, now_s).weighed)
                runner.run(recording)
                taken.append(thread_time() - begin_s)
                contacts.append(surface.contact(now_s).model_dump_json().encode())
        app.context.recorder.close()
        _, app = self._served()
        with asyncio.Runner() as runner:
            for body in batches:
                request = post(app, body)
                begin_s = thread_time()
                runner.run(request)
                posted.append(thread_time() - begin_s)
        app.context.recorder.close()
        return median_us(taken) / self._in_batch, median_us(posted) / self._in_batch, contacts

    def _served(self) -> tuple[Surface, Application]:
        surface = Surface("bench", modelfile.load(self._model), SurfaceSection(stale_ms=60_000))
        return surface, create_app([surface], TOKEN)


async def post(app: Application, body: bytes) -> None:
    """Send a batch to the application as its server does."""
    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": "POST",
        "path": "/surfaces/bench/samples",
        "root_path": "",
        "query_string": b"",
        "headers": [(b"authorization", f"Bearer {TOKEN}".encode()), (b"content-length", b"%d" % len(body))],
    }
    statuses: list[int] = []

    async def receive() -> dict[str, object]:
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: Any) -> None:  # noqa: ANN401  # as every server's
        statuses.append(message.get("status", 0))

    await app(scope, receive, send)
    assert statuses[0] == 200, statuses


def median_us(took_s: list[float]) -> float:
    """Return the median of the last half [us]."""
    return float(np.median(took_s[len(took_s) // 2 :])) * 1e6
