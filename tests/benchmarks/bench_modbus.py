"""A poll over Modbus TCP beside GET /contact, both without samples; and polls under a 1 kHz stream of samples."""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from bench_service import MOVING, SECONDS, TURNS, asked, ratio, stream
from serving import loaded, service, surfaces
from shipped import build

from beamtouch_models import runtime
from support.network.free_ports import free_port

PERIOD_MS, STREAMED_S = 20, 20
"""Period of a controller, and how long it polls under the stream."""


def run() -> list[dict[str, object]]:
    """All of them."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, modbus = Path(temporary), free_port()
        model, sections = build(folder), f"[modbus_server]\nport = {modbus}\n{surfaces(['bench'])}stale_ms = 60000\n"
        with service(folder, sections) as (pid, port):
            rows = [beside(pid, modbus, port, model, clients) for clients in (1, 16)]
            with stream(port, model, MOVING):
                streamed = polled(pid, modbus, 1, STREAMED_S, PERIOD_MS)
        name = f"poll each {PERIOD_MS} ms under 1 kHz of samples: p50"
        return [*rows, {"name": name, "value": streamed["p50_ms"], "unit": "ms", "p99_ms": streamed["p99_ms"]}]


def beside(pid: int, modbus: int, port: int, model: runtime.ModelFile, clients: int) -> dict[str, object]:
    """Compare polls with GET /contact of the same service, in turns, with this number of clients."""
    mine, theirs = [], []
    for _ in range(TURNS):
        with stream(port, model, MOVING):
            pass  # so that there is a contact
        mine.append(polled(pid, modbus, clients, SECONDS))
        theirs.append(asked(pid, port, "/contact", clients))
    row: dict[str, object] = {
        "name": f"a poll over GET /contact, {clients} client{'s' if clients > 1 else ''}",
        "value": ratio(mine, theirs, "processor_us"),
        "unit": "processor time over processor time",
    }
    for name in ("per_s", "p50_ms", "p99_ms", "processor_us"):
        row[name] = float(np.median([one[name] for one in mine]))
        row[f"GET /contact {name}"] = float(np.median([one[name] for one in theirs]))
    return row


def polled(pid: int, modbus: int, clients: int, seconds: float, period_ms: float = 0) -> dict[str, float]:
    """Measure polls for so many seconds; the processor time is that of all that the service did, per poll."""
    found, used_s = loaded(pid, "modbus_load.py", modbus, clients, seconds, period_ms)
    return found | {"processor_us": used_s / found["count"] * 1e6}
