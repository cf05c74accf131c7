"""Processor time of each stage of a sample's way, from the bytes of the device to the answer.

`python tests/benchmarks/way_of_a_sample.py` touches a beam, and takes a batch for each sample. What a stage waits
for (the line, the next batch, the network) is not in it.
"""

import sys
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from time import thread_time
from typing import TypeVar

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from shipped import build

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.delivery.client import compress
from beamtouch_daemon.processing.filters import rest_of
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_daemon.sources.registers import Block, Value, answer_to
from beamtouch_daemon.sources.rtu_frames import answers_of
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.loads import Load
from beamtouch_models.lab.rig.surface import VirtualSurface
from beamtouch_service.api.samples import decompress
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.fields import encode
from beamtouch_service.surfaces.surface import Surface as Served
from daemon.devices import with_crc
from support.surfaces.example_scenes import SCENES

T = TypeVar("T")
RESTS, TOUCHES = 200, 600
TOUCH, REST = Load(150.0, 10.0), Load(None, 0.0)
BLOCK = Block(0, 4)


class Clock:
    """Takes the time of each stage."""

    def __init__(self) -> None:
        self.took_us: dict[str, list[float]] = {}

    def time(self, stage: str, work: Callable[..., T], *arguments: object) -> T:
        """Do the work of a stage, and return what it gives."""
        begin_s = thread_time()
        outcome = work(*arguments)
        self.took_us.setdefault(stage, []).append((thread_time() - begin_s) * 1e6)
        return outcome


def frame_of(counts: list[int]) -> bytes:
    """Return the answer of a Modbus RTU unit with these registers."""
    return with_crc(bytes([1, 4, 2 * len(counts)]) + b"".join(count.to_bytes(2, "big") for count in counts))


def read(frame: bytes, values: list[Value], now_s: float) -> Reading:
    """Return the reading in an answer."""
    answer = next(answer for _, data in answers_of(1, frame) if (answer := answer_to(BLOCK, data)))
    contents = dict(enumerate(answer.registers))
    return Reading(now_s, tuple(value.decode(contents) for value in values))


def body_of(batch: Batch) -> bytes:
    """Return a batch as it travels."""
    return compress(batch.model_dump_json(exclude_defaults=True).encode())


def batch_of(body: bytes) -> Batch:
    """Return the batch that has travelled."""
    return Batch.model_validate_json(decompress(body, "gzip"))


def answer_of(surface: Served, now_s: float) -> bytes:
    """Return the answer to `GET /contact`."""
    return encode(surface.view(now_s))


def run() -> Clock:
    """Let a beam rest, then touch it; take the times of the touched samples."""
    with tempfile.TemporaryDirectory() as name:
        model = build(Path(name))
        (table,) = tomllib.loads((Path(name) / "generated.toml").read_text())["surfaces"].values()
    settings = Surface.model_validate(table)
    scene, _ = load_scene(SCENES / "bench.toml")
    beam = VirtualSurface(scene, model.metadata, seed=1, rings=False)
    pipeline, surface, clock = Pipeline(settings, rest=rest_of(settings)), Served("bench", model), Clock()
    values = [Value(register) for register in range(BLOCK.count)]
    for number in range(RESTS + TOUCHES):
        now_s = number / settings.rate_hz
        frame = frame_of(beam.counts(REST if number < RESTS else TOUCH, now_s))
        timed = clock if number >= RESTS else Clock()
        reading = timed.time("answer of the device to a reading", read, frame, values, now_s)
        samples = timed.time("reading to a sample", pipeline.process, [reading], 0.0)
        if not samples:
            continue
        head = Batch(boot_id="boot-0001", channels=model.channels, newest_age_ms=0.0, samples=[])
        batch = head.model_copy(update={"samples": [one.sample for one in samples]})
        body = timed.time("sample to a body", body_of, batch)
        received = timed.time("body to a batch", batch_of, body)
        timed.time("batch to the answer", surface.receive, received, now_s)
        timed.time("answer to JSON", answer_of, surface, now_s)
    return clock


if __name__ == "__main__":
    for stage, took_us in run().took_us.items():
        print(f"{stage:36} median {np.median(took_us):7.0f} us, 99 of 100 within {np.percentile(took_us, 99):7.0f} us")
