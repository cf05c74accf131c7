"""A thin line after an outage: `python tests/benchmarks/thin_lines.py --kbytes 40 60 --channels 4 8 --hz 100 1000`.

Rig, daemon and service as processes, the line between daemon and service a relay that carries so many kB a second. Each
reading becomes a sample, and loads move all the time. The line is cut for 20 s. From 10 to 40 s after it, the contact
is asked for ten times a second. A row for each case: fresh looks then, the 99th percentile of their ages, when the
record had everything but the last 2.5 s, and what travelled until then: bytes a sample, and kB/s.
"""

import argparse
import asyncio
import http.client
import json
import re
import sys
import tempfile
import threading
import time
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "demo"))

import numpy as np
import tomli_w

import beamtouch_models
from daemon.thin_line import ThinLine, thin_line
from line import Line, Surface
from support.network.free_ports import free_port
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES

BEFORE_S, OUTAGE_S, FROM_S, TO_S = 10.0, 20.0, 10.0, 40.0
LAG_S = 2.5
"""What is measured is durable a second or two later, also in fair weather."""
LOOK_S = 0.1


class Options(NamedTuple):
    """What all cases have in common."""

    patience_s: float
    """Longest time after the outage."""
    one_way_s: float
    surfaces: int
    is_silent: bool
    """Whether the line is silent in the outage; otherwise connections are refused."""


class Looks:
    """Asks for the contact of each surface from a thread."""

    def __init__(self, port: int, surfaces: list[str]) -> None:
        self.seen = list[tuple[float, float | None]]()
        """Time on the monotonic clock and age [ms]; None: no contact."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._ask, args=(port, surfaces), daemon=True)
        self._thread.start()

    def _ask(self, port: int, surfaces: list[str]) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        while not self._stop.wait(LOOK_S):
            for name in surfaces:
                connection.request("GET", f"/surfaces/{name}/contact")
                answer = connection.getresponse()
                body = json.loads(answer.read())
                self.seen.append((time.monotonic(), body["age_ms"] if answer.status == http.client.OK else None))

    def stop(self) -> None:
        """Ask no more."""
        self._stop.set()
        self._thread.join()

    def between(self, begin_s: float, end_s: float) -> tuple[float, float]:
        """Return the share of looks with a contact, and the 99th percentile of the ages [ms]."""
        ages_ms = [age_ms for at_s, age_ms in self.seen if begin_s <= at_s < end_s]
        fresh = [age_ms for age_ms in ages_ms if age_ms is not None]
        return len(fresh) / max(1, len(ages_ms)), float(np.percentile(fresh or [np.nan], 99))


class LineOverThin(Line):
    """The line of the demo, with another address of the service for the daemon."""

    url_of_daemon = ""
    metrics_port = 0

    def begin(self) -> dict[str, dict[str, Any]]:
        """Start rigs and service; return the sources of the daemon."""
        (self.folder / "token").write_text("a-token-of-this-benchmark")
        sources = {surface.name: self._start_rig(surface) for surface in self.surfaces}
        self.url = self._start_service()
        return sources

    def start_daemon(self, sources: dict[str, dict[str, Any]]) -> None:
        """Start the daemon, with a sample for each reading."""
        config = tomllib.loads(self._generated.read_text())
        (template,) = config["surfaces"].values()
        config["publish"].update({"url": self.url_of_daemon, "token_file": "token", "rest_ms": 0})
        config["metrics"] = {"port": self.metrics_port}
        config["surfaces"] = {name: {**template, "source": source} for name, source in sources.items()}
        (self.folder / "daemon.toml").write_text(tomli_w.dumps(config))
        self._run_daemon()


class Counted(NamedTuple):
    """Counts of a daemon."""

    in_log: float
    published: float
    readings: float
    at_s: float
    """Time on the monotonic clock."""


def counted(port: int) -> Counted:
    """Return what the metrics of a daemon say; OSError while it does not answer."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", "/metrics")
    lines = connection.getresponse().read().decode().splitlines()
    connection.close()

    def sum_of(name: str) -> float:
        return sum(float(line.rpartition(" ")[2]) for line in lines if line.startswith(f"beamtouch_{name}"))

    in_log, published = sum_of("samples_in_log{"), sum_of("samples_published_total{")
    return Counted(in_log, published, sum_of("readings_total{"), time.monotonic())


def is_running(port: int) -> bool:
    """Return whether the record of a daemon's service has samples."""
    try:
        return counted(port).published > 0
    except OSError:
        return False


async def outage(line: ThinLine, *, is_silent: bool) -> None:
    """Let nothing pass for a while."""
    await line.cut() if not is_silent else line.freeze()
    await asyncio.sleep(OUTAGE_S)
    await line.open() if not is_silent else line.thaw()


async def measure(line: LineOverThin, kbytes_s: float, hz: int, options: Options) -> str:
    """Run a case; return its figures."""
    sources = await asyncio.to_thread(line.begin)
    port, names = int(line.url.rpartition(":")[2]), [surface.name for surface in line.surfaces]
    line.metrics_port = free_port()
    async with thin_line(port, kbytes_s * 1e3, one_way_s=options.one_way_s) as thin:
        line.url_of_daemon = thin.url
        await asyncio.to_thread(line.start_daemon, sources)
        await asyncio.to_thread(wait_until, lambda: is_running(line.metrics_port), 120)
        looks = Looks(port, names)
        await asyncio.sleep(BEFORE_S)
        await outage(thin, is_silent=options.is_silent)
        before, carried = await asyncio.to_thread(counted, line.metrics_port), thin.up.carried
        healed: tuple[Counted, int] | None = None
        end_s = before.at_s + options.patience_s
        while time.monotonic() < (end_s if healed is None else before.at_s + TO_S):
            await asyncio.sleep(0.5)
            now = await asyncio.to_thread(counted, line.metrics_port)
            if healed is None and now.in_log < LAG_S * hz * len(names):
                healed = now, thin.up.carried
        looks.stop()
        last, travelled = healed or (now, thin.up.carried)
    share, age_ms = looks.between(before.at_s + FROM_S, before.at_s + TO_S)
    took_s, sent = last.at_s - before.at_s, travelled - carried
    durable = f"{took_s:.0f} s" if healed else f"not in {took_s:.0f} s, log {before.in_log:.0f} to {last.in_log:.0f}"
    measured_hz = (now.readings - before.readings) / (now.at_s - before.at_s)
    return (
        f"{share:.0%} | {age_ms:.0f} ms | {durable} | {sent / max(1, last.published - before.published):.0f} | "
        f"{sent / took_s / 1e3:.0f} | {measured_hz:.0f}"
    )


def build(folder: Path, channels: int, hz: int) -> None:
    """Build the model of the scene `bench` with so many sensors and readings a second."""
    text = (SCENES / "bench.toml").read_text().replace("size_mm = 12", "size_mm = 8")
    for key, value in (("rate_hz", hz), ("count", channels)):
        text = re.sub(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
    (folder / "bench.toml").write_text(text)
    model = beamtouch_models.resolve(beamtouch_models.read_scene(folder / "bench.toml")).place().build("bench")
    model.save(folder / "bench.onnx")
    (folder / "generated.toml").write_text(beamtouch_models.daemon_config(model.metadata))


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kbytes", type=float, nargs="+", default=[40, 60, 100, 200], help="kB/s of the line")
    parser.add_argument("--channels", type=int, nargs="+", default=[4, 8])
    parser.add_argument("--hz", type=int, nargs="+", default=[100, 1000])
    parser.add_argument("--surfaces", type=int, default=1)
    parser.add_argument("--one-way-ms", type=float, default=0.0, help="time that everything travels beside")
    parser.add_argument("--silent", action="store_true", help="the cut line says nothing, instead of refusing")
    parser.add_argument("--patience", type=float, default=90.0, help="longest time to wait for the record [s]")
    given = parser.parse_args()
    options = Options(given.patience, given.one_way_ms / 1e3, given.surfaces, given.silent)
    print("| kB/s | channels | Hz | fresh | age, p99 | durable after | B a sample | kB/s | readings a second |")
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    for channels in given.channels:
        for hz in given.hz:
            for kbytes_s in given.kbytes:
                with tempfile.TemporaryDirectory() as name:
                    folder = Path(name)
                    build(folder, channels, hz)
                    surfaces = [
                        Surface(f"s{number}", "serial", rig_options=("--no-ringing",))
                        for number in range(options.surfaces)
                    ]
                    files = (folder / "bench.toml", folder / "bench.onnx", folder / "generated.toml")
                    line = LineOverThin(folder, *files, surfaces)
                    try:
                        figures = asyncio.run(measure(line, kbytes_s, hz, options))
                    finally:
                        line.stop()
                print(f"| {kbytes_s:g} | {channels} | {hz} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
