"""Subscribers over OPC UA, each to 20 variables at 100 ms, while a load moves: what they cost, and the age they see."""

import http.client
import json
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, perf_counter, sleep, time

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from bench_service import TOKEN, contact, server

from beamtouch_models import modelfile
from beamtouch_models.building.build import build_model
from beamtouch_models.scene import load_scene
from example_scenes import SCENES
from free_ports import free_port
from opcua_hello import is_open
from processes import processor_s, resident_mb
from waiting import wait_until

LOAD = Path(__file__).parent / "opcua_load.py"
SUBSCRIBERS = (1, 10, 50)
SECONDS = 15.0
ZONES = 6
BATCH_S, PER_BATCH = 0.02, 4
"""As a daemon sends 200 readings a second."""
CROSSING = 400
"""Samples in which the load moves from one place of the model's golden answers to the next."""


def run() -> list[dict[str, object]]:
    """All of them; the first rows are without a subscriber."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, opcua = Path(temporary), free_port()
        scene, text = load_scene(SCENES / "bench.toml")
        built = build_model(scene, text, "bench", count=None, seed=0, progress=lambda _doing, _done: None)
        (folder / "bench.onnx").write_bytes(built.content)
        model = modelfile.load(folder / "bench.onnx")
        surface = f'[surfaces.bench]\nmodel = "{folder}/bench.onnx"\n' + "".join(
            f"[surfaces.bench.zones.z{number}]\nfrom_mm = {60 * number}\nto_mm = {60 * number + 40}\n"
            for number in range(ZONES)
        )
        rows = []
        with service(folder, surface) as (pid, port), moving_load(port, model):
            rows.append(row("without [opcua]", *used(pid)))
        with service(folder, f"[opcua]\nport = {opcua}\n{surface}") as (pid, port), moving_load(port, model):
            wait_until(lambda: is_open(f"opc.tcp://127.0.0.1:{opcua}/"))
            rows.append(row("no subscriber", *used(pid)))
            for count in SUBSCRIBERS:
                command = [sys.executable, str(LOAD), str(opcua), "bench", str(count), str(SECONDS)]
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


@contextmanager
def service(folder: Path, sections: str) -> Iterator[tuple[int, int]]:
    """Run a service for a block; gives its process id and its port for HTTP."""
    (folder / "token").write_text(TOKEN)
    (folder / "service.toml").write_text(f'[server]\nwrite_token_file = "token"\n{sections}')
    command = ("-m", "beamtouch_service.cli", "run", "--port", "0", "--config", folder / "service.toml")
    with server(*command) as (process, port):
        yield process.pid, port


@contextmanager
def moving_load(port: int, model: modelfile.ModelFile) -> Iterator[None]:
    """Send samples of a load that moves, for a block."""
    stop = threading.Event()
    sender = threading.Thread(target=send, args=(port, model, stop))
    sender.start()
    try:
        wait_until(lambda: contact(port).startswith(b'{"surface"'))
        yield
    finally:
        stop.set()
        sender.join()


def send(port: int, model: modelfile.ModelFile, stop: threading.Event) -> None:
    """Send batches until told to stop."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
    places = np.array(model.metadata.golden.deflection_mm)
    number, next_s = 0, monotonic()
    while not stop.is_set():
        samples = []
        for _ in range(PER_BATCH):
            number += 1
            place, part = number // CROSSING, number % CROSSING / CROSSING
            before, after = places[place % len(places)], places[(place + 1) % len(places)]
            samples.append(
                {
                    "sequence": number,
                    "acquired_unix_us": int(time() * 1e6),
                    "deflection_mm": (before + part * (after - before)).tolist(),
                    "quality": ["good"] * len(before),
                }
            )
        batch = {"boot_id": "boot-0001", "channels": model.channels, "newest_age_ms": 0.0, "samples": samples}
        connection.request("POST", "/surfaces/bench/samples", json.dumps(batch), headers)
        answer = connection.getresponse()
        assert answer.status == 200, answer.read()
        answer.read()
        next_s += BATCH_S
        sleep(max(0.0, next_s - monotonic()))


def used(pid: int) -> tuple[float, float]:
    """Return the share of a core that a process uses in the next while [%], and its memory [MB]."""
    begin_s, before_s = perf_counter(), processor_s(pid)
    sleep(SECONDS)
    return 100 * (processor_s(pid) - before_s) / (perf_counter() - begin_s), resident_mb(pid)
