"""A poll over Modbus TCP beside GET /contact, both without samples; and polls under a 1 kHz stream of samples."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from bench_service import MOVING, SECONDS, TOKEN, TURNS, loaded, ratio, server, stream
from shipped import build

from beamtouch_models import modelfile
from free_ports import free_port
from processes import processor_s

LOAD = Path(__file__).parent / "modbus_load.py"
PERIOD_MS, STREAMED_S = 20, 20
"""Period of a controller, and how long it polls under the stream."""


def run() -> list[dict[str, object]]:
    """All of them."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, modbus = Path(temporary), free_port()
        token, config, model = folder / "token", folder / "service.toml", build(folder)
        token.write_text(TOKEN)
        surface = '[surfaces.bench]\nmodel = "bench.onnx"\nstale_ms = 60000\n'
        config.write_text(f"[modbus_server]\nport = {modbus}\n{surface}")
        command = ("-m", "beamtouch_service.cli", "run", "--port", "0", "--config", config, "--write-token-file", token)
        with server(*command) as (service, port):
            rows = [beside(service.pid, modbus, port, model, clients) for clients in (1, 16)]
            with stream(port, model, MOVING):
                streamed = polled(service.pid, modbus, 1, STREAMED_S, PERIOD_MS)
        name = f"poll each {PERIOD_MS} ms under 1 kHz of samples: p50"
        return [*rows, {"name": name, "value": streamed["p50_ms"], "unit": "ms", "p99_ms": streamed["p99_ms"]}]


def beside(pid: int, modbus: int, port: int, model: modelfile.ModelFile, clients: int) -> dict[str, object]:
    """Compare polls with GET /contact of the same service, in turns, with this number of clients."""
    mine, theirs = [], []
    for _ in range(TURNS):
        with stream(port, model, MOVING):
            pass  # so that there is a contact
        mine.append(polled(pid, modbus, clients, SECONDS))
        theirs.append(loaded(pid, port, "/contact", clients))
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
    begin_s = processor_s(pid)
    arguments = [sys.executable, str(LOAD), *map(str, (modbus, clients, seconds, period_ms))]
    found: dict[str, float] = json.loads(subprocess.check_output(arguments, text=True))
    return found | {"processor_us": (processor_s(pid) - begin_s) / found["count"] * 1e6}
