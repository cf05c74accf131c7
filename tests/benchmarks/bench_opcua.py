"""Subscribers over OPC UA while a load moves: what they cost, the age they see, and how long `GET /contact` takes.

Each subscribes to 20 variables at 100 ms. `python tests/benchmarks/bench_opcua.py [--clients 0 5 20]` repeats this in
rounds; `--before CHECKOUT` measures another checkout, too, in turns with this one.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter, sleep
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from bench_service import Flow, stream
from serving import HERE, build_with, service, surfaces
from shipped import build

from beamtouch_models.runtime import ModelFile
from service.process.opcua_hello import is_open
from support.network.free_ports import free_port
from support.programs.processes import processor_s, resident_mb
from support.running.waiting import wait_until

SUBSCRIBERS = (0, 1, 10, 50)
SECONDS = 15.0
ZONES = 6
MOVED = Flow(("bench",), 50, 4)
"""As a daemon sends 200 readings a second."""
CROSSING = 400
"""Samples in which the load moves from one place of the model's golden answers to the next."""
SURFACE = surfaces(["bench"]) + "".join(
    f"[surfaces.bench.zones.z{number}]\nfrom_mm = {60 * number}\nto_mm = {60 * number + 40}\n"
    for number in range(ZONES)
)


def run() -> list[dict[str, object]]:
    """All of them; the first rows are without a subscriber."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        model = build(folder)
        return [_row(words_of(count), measure(folder, model, count)) for count in (None, *SUBSCRIBERS)]


def words_of(count: int | None) -> str:
    """Return a number of subscribers in words; None is without OPC UA."""
    if count is None:
        return "without [opcua]"
    return f"{count or 'no'} subscriber{'' if count == 1 else 's'}"


def _row(name: str, figures: dict[str, float]) -> dict[str, object]:
    return {"name": name, "value": figures.pop("share"), "unit": "% of a core", **figures}


def measure(
    folder: Path,
    model: ModelFile,
    count: int | None,
    checkout: Path | None = None,
    seconds: float = SECONDS,
    flow: Flow = MOVED,
) -> dict[str, float]:
    """Return the figures of a service with so many subscribers; None is without OPC UA."""
    opcua = free_port()
    sections = SURFACE if count is None else f"[opcua]\nport = {opcua}\n{SURFACE}"
    with service(folder, sections, checkout) as (pid, port), stream(port, model, flow, moved(model)):
        if count is None:
            return used(pid, port, seconds)
        wait_until(lambda: is_open(f"opc.tcp://127.0.0.1:{opcua}/"))
        if not count:
            return used(pid, port, seconds)
        command = [sys.executable, str(HERE / "opcua_load.py"), str(opcua), "bench", str(count), str(seconds)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as clients:
            assert clients.stdout is not None
            clients.stdout.readline()
            figures = used(pid, port, seconds)
            seen: dict[str, float] = json.loads(clients.stdout.read())
            return figures | seen


def moved(model: ModelFile) -> Callable[[int], list[float]]:
    """Return what gives the deflections of each sample of a load that moves."""
    places = np.array(model.metadata.golden.deflection_mm)

    def deflection_mm(number: int) -> list[float]:
        place, part = number // CROSSING, number % CROSSING / CROSSING
        before, after = places[place % len(places)], places[(place + 1) % len(places)]
        found: list[float] = (before + part * (after - before)).tolist()
        return found

    return deflection_mm


def used(pid: int, port: int, seconds: float) -> dict[str, float]:
    """Ask for the contact for a while; return what the process takes, and the percentiles of the time to an answer."""
    command = [sys.executable, str(HERE / "contact_probe.py"), str(port), "bench", str(seconds)]
    begin_s, before_s = perf_counter(), processor_s(pid)
    asked = json.loads(subprocess.check_output(command, text=True))["contact"]
    sleep(max(0.0, begin_s + seconds - perf_counter()))
    share = 100 * (processor_s(pid) - before_s) / (perf_counter() - begin_s)
    times = {f"contact_{name}": asked[name] for name in ("p50_ms", "p99_ms")}
    return {"share": share, "memory_mb": resident_mb(pid), **times}


def main() -> None:
    """Repeat it in rounds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clients", type=int, nargs="+", default=[0, 5, 20])
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--per-s", type=int, default=200, help="samples a second")
    words = "another checkout, to measure in turns with this one"
    parser.add_argument("--before", type=Path, metavar="CHECKOUT", help=words)
    given = parser.parse_args()
    checkouts = {"before": given.before.resolve()} if given.before else {}
    flow, found = Flow(("bench",), 50, given.per_s // 50), dict[tuple[str, int], list[dict[str, Any]]]()
    with tempfile.TemporaryDirectory() as temporary:
        folders = {name: Path(temporary) / name for name in (*checkouts, "now")}
        for name, folder in folders.items():
            folder.mkdir()
            build_with(checkouts.get(name), folder)
        model = build(Path(temporary))
        for _ in range(given.rounds):
            for count in given.clients:
                for name, folder in folders.items():
                    figures = measure(folder, model, count, checkouts.get(name), given.seconds, flow)
                    found.setdefault((name, count), []).append(figures)
                    print(f"{name}, {words_of(count)}: {text(found[name, count][-1:])}", file=sys.stderr, flush=True)
    for (name, count), rounds in found.items():
        print(f"{name}, {words_of(count)}: {text(rounds)}", flush=True)


def text(rounds: list[dict[str, Any]]) -> str:
    """Return the medians of rounds in words."""
    return ", ".join(f"{name} {median(one[name] for one in rounds):.3g}" for name in rounds[0])


if __name__ == "__main__":
    main()
