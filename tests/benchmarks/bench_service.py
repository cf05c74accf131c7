"""The service under eight surfaces of 1 kHz at rest: GET /contact against a bare ASGI answer and a plain FastAPI route.

Also its memory and the time per estimate.
"""

import http.client
import json
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, perf_counter, sleep, time
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from serving import TOKEN, loaded, server, service, surfaces
from shipped import build

from beamtouch_models.runtime import ModelFile
from support.programs.processes import resident_mb

TURNS, SECONDS = 5, 2.0
ESTIMATES = 3000
GOALS = {"a bare ASGI answer": "at least 0.3", "a plain FastAPI route": "at least 0.9"}

HOSTED = """
import socket, sys
import uvicorn
from beamtouch_service.host.serve import configure

{app}
# The protocol is explicit: asyncio turns off Nagle's algorithm only then.
listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
listener.bind(("127.0.0.1", 0))
print(f"listening on http://127.0.0.1:{{listener.getsockname()[1]}}", flush=True)
uvicorn.Server(configure(app)).run([listener])
"""
BARE = """
BODY = b"x" * int(sys.argv[1])
HEADERS = [(b"content-type", b"application/json"), (b"content-length", str(len(BODY)).encode())]

async def app(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": HEADERS})
    await send({"type": "http.response.body", "body": BODY})
"""
PLAIN = """
from fastapi import FastAPI
from beamtouch_service.surfaces.fields import Contact

CONTACT = Contact.model_validate_json(sys.argv[1])
app = FastAPI()

@app.get("/")
async def get_contact(surface: str | None = None) -> Contact:
    return CONTACT.model_copy(update={"age_ms": 12.3})
"""


def run() -> list[dict[str, object]]:
    """All of them."""
    with tempfile.TemporaryDirectory() as folder:
        model = build(Path(folder))
        with service(Path(folder), surfaces(RESTING.surfaces)) as (pid, port), stream(port, model, RESTING):
            body = contact(port, path_of(RESTING))
            peers = {
                "a bare ASGI answer": ("-c", HOSTED.format(app=BARE), str(len(body))),
                "a plain FastAPI route": ("-c", HOSTED.format(app=PLAIN), body.decode()),
            }
            rows = []
            for name, program in peers.items():
                with server(*program) as (peer_pid, peer_port):
                    pair = ((pid, port, path_of(RESTING)), (peer_pid, peer_port, "/"))
                    rows += [answers(pair, name, clients) for clients in (1, 16)]
            rows.append({"name": "service: resident memory", "value": resident_mb(pid), "unit": "MB"})
        return [*rows, estimates(model)]


class Flow(NamedTuple):
    """Samples as a daemon sends them."""

    surfaces: tuple[str, ...]
    batches_per_s: int
    """Of each surface."""
    in_batch: int


MOVING = Flow(("bench",), 250, 4)
"""A surface of 1 kHz under a load that moves."""
RESTING = Flow(tuple(f"s{number}" for number in range(8)), 20, 1)


@contextmanager
def stream(
    port: int, model: ModelFile, flow: Flow, deflection_mm: Callable[[int], list[float]] | None = None
) -> Iterator[None]:
    """Send samples of a contact for a block: those of its first golden answer, or of these deflections by number."""
    stop, golden_mm = threading.Event(), model.metadata.golden.deflection_mm[0]
    course = deflection_mm or (lambda _number: golden_mm)
    senders = [
        threading.Thread(target=send, args=(port, model.channels, flow, name, course, stop)) for name in flow.surfaces
    ]
    for sender in senders:
        sender.start()
    try:
        deadline_s = monotonic() + 30
        while not contact(port, path_of(flow)).startswith(b'{"surface"'):
            assert monotonic() < deadline_s
            sleep(0.05)
        yield
    finally:
        stop.set()
        for sender in senders:
            sender.join()


def path_of(flow: Flow) -> str:
    """Return the path of the contact of the first surface."""
    return f"/surfaces/{flow.surfaces[0]}/contact"


def send(
    port: int,
    channels: list[str],
    flow: Flow,
    surface: str,
    deflection_mm: Callable[[int], list[float]],
    stop: threading.Event,
) -> None:
    """Send batches of a surface until told to stop."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    number, next_s = 1, monotonic()
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
    while not stop.is_set():
        samples = [
            {
                "sequence": number + index,
                "acquired_unix_us": int(time() * 1e6),
                "deflection_mm": deflection_mm(number + index),
                "quality": ["good"] * len(channels),
            }
            for index in range(flow.in_batch)
        ]
        number += flow.in_batch
        batch = {
            "boot_id": "benchmark-1",
            "channels": channels,
            "newest_age_ms": 0.0,
            "sent_us": int(monotonic() * 1e6),
            "samples": samples,
        }
        connection.request("POST", f"/surfaces/{surface}/samples", json.dumps(batch), headers)
        answer = connection.getresponse()
        assert answer.read()
        assert answer.status == 200
        next_s += 1 / flow.batches_per_s
        sleep(max(0.0, next_s - monotonic()))


def contact(port: int, path: str = "/contact") -> bytes:
    """Return one answer."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("GET", path)
    try:
        return connection.getresponse().read()
    finally:
        connection.close()


Asked = tuple[int, int, str]
"""Process, port and path of a server."""


def answers(pair: tuple[Asked, Asked], peer: str, clients: int) -> dict[str, object]:
    """Compare the service with a peer, in turns, with this number of clients."""
    turns: list[list[dict[str, float]]] = [[], []]
    for turn in range(TURNS):
        for which in (0, 1) if turn % 2 else (1, 0):
            turns[which].append(asked(*pair[which], clients))
    mine, theirs = turns
    row: dict[str, object] = {
        "name": f"GET /contact over {peer}, {clients} client{'s' if clients > 1 else ''}",
        "value": ratio(mine, theirs, "per_s"),
        "unit": "requests/s over requests/s",
        "goal": GOALS[peer],
        "processor time over its": ratio(mine, theirs, "processor_us"),
    }
    for name in ("per_s", "p50_ms", "p99_ms", "processor_us"):
        row[name] = float(np.median([one[name] for one in mine]))
        row[f"peer {name}"] = float(np.median([one[name] for one in theirs]))
    return row


def ratio(mine: list[dict[str, float]], theirs: list[dict[str, float]], name: str) -> float:
    """Return the median over the turns."""
    return float(np.median([one[name] / other[name] for one, other in zip(mine, theirs, strict=True)]))


def asked(pid: int, port: int, path: str, clients: int) -> dict[str, float]:
    """Measure one server for a turn; its processor time is that of all it did meanwhile, per answer."""
    found, used_s = loaded(pid, "http_load.py", port, path, clients, SECONDS)
    statuses = found.pop("statuses")
    assert statuses == ["200"], statuses
    return {name: float(value) for name, value in found.items()} | {"processor_us": used_s / found["count"] * 1e6}


def estimates(model: ModelFile) -> dict[str, object]:
    """One sample through the model as the service does it, against the bare call of the runtime, in turns."""
    golden = model.metadata.golden
    values = np.array(golden.deflection_mm[:1], np.float32)
    weights = np.array(golden.whitening_per_mm[:1], np.float32)
    feed = {"deflection_mm": values, "whitening_per_mm": weights}
    mine, bare = [], []
    for _ in range(TURNS):
        begin_s = perf_counter()
        for _ in range(ESTIMATES):
            model.run(values, weights)
        middle_s = perf_counter()
        for _ in range(ESTIMATES):
            model.graph.session.run(None, feed)
        mine.append((middle_s - begin_s) / ESTIMATES)
        bare.append((perf_counter() - middle_s) / ESTIMATES)
    return {
        "name": "time per estimate over a bare onnxruntime call",
        "value": float(np.median([one / other for one, other in zip(mine, bare, strict=True)])),
        "unit": "s over s",
        "us": float(np.median(mine)) * 1e6,
        "bare us": float(np.median(bare)) * 1e6,
    }
