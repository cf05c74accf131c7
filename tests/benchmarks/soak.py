"""Endurance run: `python tests/benchmarks/soak.py --minutes 60 [--rate-hz 1000] [-o FILE]`.

Rig, daemon and service as processes, loads moving all the time, contacts asked for 20 times a second and held against
the rig's truth. Says every minute how things stand, and at the end writes a table.
"""

import argparse
import json
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "demo"))

import httpx2
import numpy as np
from contact_watch import Watched, watch
from shipped import build

from line import Line, Surface
from support.programs.processes import processor_s, resident_mb
from support.running.waiting import wait_until

ASK_S = 0.05


@dataclass
class Used:
    """What the processes used, and what came of it."""

    memory_mb: dict[str, list[float]] = field(default_factory=dict)
    processor: dict[str, float] = field(default_factory=dict)
    """Cores that each process kept busy."""
    at_service: dict[str, int] = field(default_factory=dict)
    """The service's counts of samples, and of events."""
    at_daemon: dict[str, int] = field(default_factory=dict)
    """The daemon's summary."""


def main() -> int:
    """Run; returns 1 if a stale position was served or a sample was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate-hz", type=int, default=1000)
    parser.add_argument("-o", "--output", type=Path, help="write the table to this file as well")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seen, used = soak(Path(folder), options.minutes * 60, options.rate_hz)
    text = report(seen, used, options.minutes, options.rate_hz)
    print(text)
    if options.output is not None:
        options.output.write_text(text)
    sent, taken = used.at_daemon, used.at_service
    lost = sent["samples_dropped"] + taken["lost"] + sent["samples_published"] - taken["accepted"]
    return 1 if seen.too_old or lost else 0


def soak(folder: Path, seconds: float, rate_hz: int) -> tuple[Watched, Used]:
    """Run the line for so long; return what was seen, and what it took."""
    build(folder, rate_hz=rate_hz)
    scene_path, model_path, config = folder / "bench.toml", folder / "bench.onnx", folder / "generated.toml"
    line = Line(folder, scene_path, model_path, config, [Surface("soak", "serial", rig_options=("--no-ringing",))])
    seen, used, stop = Watched(), Used(), threading.Event()
    with line, httpx2.Client(base_url=line.url, trust_env=False) as client:
        wait_until(lambda: client.get("/health/ready").is_success)
        watching = threading.Thread(target=watch, args=(line, "soak", stop, seen, ASK_S))
        watching.start()
        begin_s = time.monotonic()
        while (left_s := begin_s + seconds - time.monotonic()) > 0:
            time.sleep(min(60.0, left_s))
            remember_memory(line, used)
            print(f"{(time.monotonic() - begin_s) / 60:.0f} min: {status(seen, used)}", flush=True)
        stop.set()
        watching.join()
        used.processor = {name: processor_s(pid) / (time.monotonic() - begin_s) for name, pid in line.pids().items()}
        if dead := line.dead():
            raise RuntimeError(f"{', '.join(dead)} ended by itself")
        line.end("daemon")
        used.at_service = counts(client)
    used.at_daemon = json.loads(line.summary.read_text())["surfaces"]["soak"]
    return seen, used


def remember_memory(line: Line, used: Used) -> None:
    """Note the resident memory of each process."""
    for name, pid in line.pids().items():
        used.memory_mb.setdefault(name, []).append(resident_mb(pid))


def counts(client: httpx2.Client) -> dict[str, int]:
    """Return the service's own counts of samples, and of the contacts on its record."""
    found: dict[str, int] = client.get("/surfaces/soak").json()["samples"]
    page: dict[str, Any] = {"next": None}
    ends: list[str] = []
    asked: dict[str, str | int] = {"kind": "contact", "limit": 1000}
    while True:
        page = client.get("/events", params=asked | ({"after": page["next"]} if page["next"] else {})).json()
        ends += [event["end"] for event in page["events"]]
        if page["next"] is None:
            return found | {"events": len(ends), "not whole": sum(end not in ("lift", "open") for end in ends)}


def status(seen: Watched, used: Used) -> str:
    """Return how things stand, in a line."""
    memory = ", ".join(f"{name} {values[-1]:.1f} MB" for name, values in used.memory_mb.items())
    return (
        f"{seen.asked} asked, {seen.problems.total()} problems, {len(seen.too_old)} too old, "
        f"{seen.outside} of {seen.compared} outside, {len(seen.mistakes)} mistaken, {seen.unexplained} unexplained; "
        f"{memory}"
    )


def report(seen: Watched, used: Used, minutes: float, rate_hz: int) -> str:
    """Return the table."""
    summary, at_service = used.at_daemon, used.at_service
    settling = summary["readings"] - sum(summary[f"samples_{end}"] for end in ("published", "dropped", "in_log"))
    rows = [
        ("readings", f"{summary['readings']:,}"),
        ("readings missed by the daemon", f"{summary['readings_lost']:,}"),
        ("readings without a sample of their own, at rest and while the filter settles", f"{settling:,}"),
        ("samples acknowledged by the service", f"{summary['samples_published']:,}"),
        ("samples dropped", f"{summary['samples_dropped']:,}"),
        ("samples left on disk", f"{summary['samples_in_log']:,}"),
        ("samples that the service took", f"{at_service['accepted']:,}"),
        ("samples that the service missed", f"{at_service['lost']:,}"),
        ("contacts on its record", f"{at_service['events']:,}"),
        ("of them without a lift", f"{at_service['not whole']:,}"),
        ("contacts asked for", f"{seen.asked:,}"),
        ("answers that were problems", ", ".join(f"{n} {kind}" for kind, n in seen.problems.items()) or "0"),
        ("contacts older than their limit", f"{len(seen.too_old):,}"),
        ("contacts held against the truth", f"{seen.compared:,}"),
        ("of them outside the 95 % interval", f"{seen.outside / max(1, seen.compared):.2%}"),
        ("of them contact for clear, or the other way round", f"{len(seen.mistakes):,}"),
        ("of them unexplained", f"{seen.unexplained:,}"),
    ]
    for name, values in used.memory_mb.items():
        slope = np.polyfit(np.arange(len(values)), values, 1)[0] * 60 if len(values) > 2 else float("nan")
        rows.append((f"memory of {name}", f"{values[0]:.1f} to {values[-1]:.1f} MB, {slope:+.2f} MB per hour"))
    rows += [(f"processor of {name}", f"{share:.0%} of a core") for name, share in used.processor.items()]
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    command = f"python tests/benchmarks/soak.py --minutes {minutes:g} --rate-hz {rate_hz}"
    return f"# Endurance run of {minutes:g} minutes\n\n`{command}`\n\n| | |\n|---|---|\n{table}\n"


if __name__ == "__main__":
    sys.exit(main())
