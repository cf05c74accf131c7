"""Subscribers over OPC UA, each to 20 variables at 100 ms, while a load moves: what they cost, and the age they see."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, sleep

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from bench_service import Flow, stream
from serving import HERE, service, surfaces
from shipped import build

from beamtouch_models.runtime import ModelFile
from service.process.opcua_hello import is_open
from support.network.free_ports import free_port
from support.programs.processes import processor_s, resident_mb
from support.running.waiting import wait_until

SUBSCRIBERS = (1, 10, 50)
SECONDS = 15.0
ZONES = 6
MOVED = Flow(("bench",), 50, 4)
"""As a daemon sends 200 readings a second."""
CROSSING = 400
"""Samples in which the load moves from one place of the model's golden answers to the next."""


def run() -> list[dict[str, object]]:
    """All of them; the first rows are without a subscriber."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, opcua = Path(temporary), free_port()
        model = build(folder)
        surface = surfaces(["bench"]) + "".join(
            f"[surfaces.bench.zones.z{number}]\nfrom_mm = {60 * number}\nto_mm = {60 * number + 40}\n"
            for number in range(ZONES)
        )
        rows = []
        with service(folder, surface) as (pid, port), stream(port, model, MOVED, moved(model)):
            rows.append(row("without [opcua]", *used(pid)))
        with (
            service(folder, f"[opcua]\nport = {opcua}\n{surface}") as (pid, port),
            stream(port, model, MOVED, moved(model)),
        ):
            wait_until(lambda: is_open(f"opc.tcp://127.0.0.1:{opcua}/"))
            rows.append(row("no subscriber", *used(pid)))
            for count in SUBSCRIBERS:
                command = [sys.executable, str(HERE / "opcua_load.py"), str(opcua), "bench", str(count), str(SECONDS)]
                with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as clients:
                    assert clients.stdout is not None
                    clients.stdout.readline()
                    share, memory_mb = used(pid)
                    figures = json.loads(clients.stdout.read())
                rows.append(row(f"{count} subscriber{'s' if count > 1 else ''}", share, memory_mb) | figures)
        return rows


def row(name: str, share: float, memory_mb: float) -> dict[str, object]:
    """Return a row of the table."""
    return {"name": name, "value": share, "unit": "% of a core", "memory_mb": memory_mb}


def moved(model: ModelFile) -> Callable[[int], list[float]]:
    """Return what gives the deflections of each sample of a load that moves."""
    places = np.array(model.metadata.golden.deflection_mm)

    def deflection_mm(number: int) -> list[float]:
        place, part = number // CROSSING, number % CROSSING / CROSSING
        before, after = places[place % len(places)], places[(place + 1) % len(places)]
        found: list[float] = (before + part * (after - before)).tolist()
        return found

    return deflection_mm


def used(pid: int) -> tuple[float, float]:
    """Return the share of a core that a process uses in the next while [%], and its memory [MB]."""
    begin_s, before_s = perf_counter(), processor_s(pid)
    sleep(SECONDS)
    return 100 * (processor_s(pid) - before_s) / (perf_counter() - begin_s), resident_mb(pid)
