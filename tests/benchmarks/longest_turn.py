"""The longest time in which the event loop of the service does not turn, for the largest requests it takes.

A task in the service wakes up all the time and notes what passed between two of its turns: processor time of the thread
of the loop, and time by the clock, which other programs on the machine make longer. Each figure is the least of a few
requests.
"""

import argparse
import json
import mmap
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import httpx2
import numpy as np
from serving import TOKEN, server

from beamtouch_models import read_scene, resolve
from beamtouch_service.api.samples import MAX_BODY_BYTES
from beamtouch_service.samples import MAX_SAMPLES
from support.surfaces.example_scenes import ROUGH, SCENES

WATCHED = """
import asyncio, mmap, struct, sys, time
from beamtouch_service.host import serve

file = open(sys.argv.pop(1), "r+b")
longest, tick = mmap.mmap(file.fileno(), 16), serve._tick


async def watch(context):
    ticking, before = asyncio.ensure_future(tick(context)), (time.thread_time(), time.perf_counter())
    while not ticking.done():
        await asyncio.sleep(0)
        now = time.thread_time(), time.perf_counter()
        passed = [max(b - a, c) for a, b, c in zip(before, now, struct.unpack("dd", longest[:]))]
        longest[:] = struct.pack("dd", *passed)
        before = now


serve._tick = watch
from beamtouch_service.cli import main

sys.exit(main())
"""
SURFACES = 100
SENSORS = (4, 8)
CHANNELS = (4, 8, 16, 64)
Course = Callable[[int, int], np.ndarray]


def rest(number: int, channels: int) -> np.ndarray:
    return 1e-3 * np.random.default_rng(number).standard_normal(channels)


def touches(number: int, channels: int) -> np.ndarray:
    """Contacts of three samples each, with as much rest between them: each is looked at for wrong wiring."""
    return 0.5 * np.sin(np.pi * (np.arange(channels) + 1) / (channels + 1)) * (number // 3 % 2)


class Sender:
    """Sends batches as large as they may be to one surface."""

    def __init__(self, post: Callable[..., httpx2.Response], boot_id: str, channels: int, course: Course) -> None:
        self._post, self._boot_id, self._channels, self._course = post, boot_id, channels, course
        root = np.random.default_rng(1).standard_normal((channels, channels))
        covariance_mm2 = 1e-6 * (root @ root.T / channels + np.eye(channels))
        self._triangle = [float(f"{value:.6g}") for value in covariance_mm2[np.tril_indices(channels)]]
        self._sent = 0
        size = [len(json.dumps(self._batch(count, is_backlog=False))) for count in (20, 40)]
        self._most = min(MAX_SAMPLES, int(0.97 * MAX_BODY_BYTES / ((size[1] - size[0]) / 20)))

    def _batch(self, count: int, *, is_backlog: bool) -> dict[str, object]:
        samples = [
            {
                "sequence": number + 1,
                "acquired_unix_us": 1_800_000_000_000_000 + 5000 * number,
                "deflection_mm": [float(f"{value:.7g}") for value in self._course(number, self._channels)],
                "quality": ["good"] * self._channels,
                "readings": 10,
                "covariance_mm2": self._triangle,
            }
            for number in range(self._sent, self._sent + count)
        ]
        names = [f"s{number + 1}" for number in range(self._channels)]
        age_ms = None if is_backlog else 1.0
        head = {"boot_id": self._boot_id, "channels": names, "newest_age_ms": age_ms, "backlog": is_backlog}
        return head | {"oldest": 1, "samples": samples}

    def send(self, count: int = 0, *, is_backlog: bool = False) -> Callable[[], int]:
        """Return what sends the next samples, by default as many as a batch may have."""
        content = json.dumps(self._batch(count or self._most, is_backlog=is_backlog)).encode()
        self._sent += count or self._most
        return lambda: len(self._post(content=content).raise_for_status().request.content)


def main() -> int:
    """Print a row for each request; returns 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5, help="requests of each kind (default: 5)")
    rounds = parser.parse_args().rounds
    print(f"{'request':48} {'bytes':>8} {'processor ms':>13} {'clock ms':>9}")
    for sensors in SENSORS:
        with tempfile.TemporaryDirectory() as folder:
            _measure(Path(folder), sensors, rounds)
    return 0


def _measure(folder: Path, sensors: int, rounds: int) -> None:
    scene = (SCENES / "bench.toml").read_text().replace("count = 4", f"count = {sensors}")
    surface = resolve(read_scene(scene.replace("size_mm", "# size_mm")))
    surface.place(criterion="eigenvalue-product", effort=ROUGH).build("bench").save(folder / "bench.onnx")
    names = [f"s{number}" for number in range(SURFACES if sensors == SENSORS[-1] else 1)]
    sections = "".join(f"[surfaces.{name}]\nmodel = 'bench.onnx'\nstale_ms = 60000\n" for name in names)
    (folder / "token").write_text(TOKEN)
    (folder / "service.toml").write_text(f"[server]\nport = 0\nwrite_token_file = 'token'\n{sections}")
    (folder / "longest").write_bytes(bytes(16))
    command = ("-c", WATCHED, folder / "longest", "run", "--config", folder / "service.toml")
    headers = {"Authorization": f"Bearer {TOKEN}"}
    with (
        server(*command) as (_, port),
        (folder / "longest").open("r+b") as file,
        httpx2.Client(base_url=f"http://127.0.0.1:{port}", headers=headers, trust_env=False, timeout=300) as client,
    ):
        longest = mmap.mmap(file.fileno(), 16)

        def show(name: str, requests: list[Callable[[], int]]) -> None:
            found = []
            for request in requests:
                time.sleep(0.2)
                longest[:] = bytes(16)
                size = request()
                found.append(struct.unpack("dd", longest[:]))
            processor_s, clock_s = (min(one[place] for one in found) for place in (0, 1))
            print(f"{name:48} {size:8} {processor_s * 1e3:13.1f} {clock_s * 1e3:9.1f}", flush=True)

        for channels in [one for one in CHANNELS if one >= sensors]:
            for course in (rest, touches):
                for is_backlog in (False, True):
                    words = "backlog" if is_backlog else "live"
                    boot_id = f"boot-{channels}-{course.__name__}-{words}"
                    sender = Sender(partial(client.post, "/surfaces/s0/samples"), boot_id, channels, course)
                    sender.send(1)()
                    time.sleep(1)  # what is on record of the boot is read
                    requests = [sender.send(is_backlog=is_backlog) for _ in range(rounds)]
                    show(f"{sensors} sensors, {channels} channels, {course.__name__}, {words}", requests)
        for path in ("/openapi.json", "/metrics", "/surfaces", "/surfaces/s0/beam"):
            show(f"{path}, {len(names)} surfaces", [partial(_length, client, path)] * rounds)


def _length(client: httpx2.Client, path: str) -> int:
    return len(client.get(path).content)


if __name__ == "__main__":
    sys.exit(main())
