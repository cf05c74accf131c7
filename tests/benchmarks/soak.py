"""Endurance run: `python tests/benchmarks/soak.py --minutes 60 [--rate-hz 1000] [-o docs/soak.md]`.

Rig, daemon and service as processes, loads moving all the time, contacts asked for 20 times a second and held against
the rig's truth. Says every minute how things stand, and at the end writes a table.
"""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "demo"))

import httpx2
import numpy as np
from shipped import build

from line import Line, Surface, Truth
from processes import processor_s, resident_mb

ASK_S = 0.05
SETTLED_S = 0.1
STALE_MS = 500.0


@dataclass
class Seen:
    """What came of asking."""

    asked: int = 0
    problems: Counter[str] = field(default_factory=Counter)
    """By type, without what all have in common."""
    too_old: int = 0
    """Served although older than the limit: must stay 0."""
    compared: int = 0
    outside: int = 0
    """The truth outside of the stated interval."""
    mistaken: int = 0
    """A contact where nothing touched, or none where something did."""
    unexplained: int = 0
    """Answers that neither rest nor one contact explains the sample, though it does."""
    memory_mb: dict[str, list[float]] = field(default_factory=dict)
    processor: dict[str, float] = field(default_factory=dict)
    """Cores that each process kept busy."""
    at_service: dict[str, int] = field(default_factory=dict)
    """The service's counts of samples, and of events."""


def main() -> int:
    """Run; returns 1 if a stale position was served or a sample was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate-hz", type=int, default=1000)
    parser.add_argument("-o", "--output", type=Path, help="write the table to this file as well")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        seen, summary = soak(Path(folder), options.minutes * 60, options.rate_hz)
    text = report(seen, summary, options.minutes, options.rate_hz)
    print(text)
    if options.output is not None:
        options.output.write_text(text)
    lost = (
        summary["samples_dropped"]
        + seen.at_service["lost"]
        + summary["samples_published"]
        - seen.at_service["accepted"]
    )
    return 1 if seen.too_old or lost else 0


def soak(folder: Path, seconds: float, rate_hz: int) -> tuple[Seen, dict[str, int]]:
    """Run the line for so long; return what was seen, and the daemon's summary."""
    build(folder, rate_hz=rate_hz)
    scene_path, model_path, config = folder / "bench.toml", folder / "bench.onnx", folder / "generated.toml"
    line = Line(folder, scene_path, model_path, config, [Surface("soak", "serial", rig_options=("--no-ringing",))])
    seen = Seen()
    with line, httpx2.Client(base_url=line.url, trust_env=False) as client:
        wait_until_ready(client)
        begin_s = minute_s = time.monotonic()
        truth = Truth(line.truth("soak"))
        while (now_s := time.monotonic()) - begin_s < seconds:
            ask(client, truth, seen)
            if now_s - minute_s >= 60:
                minute_s = now_s
                remember_memory(line, seen)
                truth.close()
                truth = Truth(line.truth("soak"))
                truth.skip_to_end()
                print(f"{(now_s - begin_s) / 60:.0f} min: {status(seen)}", flush=True)
            time.sleep(max(0.0, ASK_S - (time.monotonic() - now_s)))
        truth.close()
        seen.processor = {name: processor_s(pid) / (time.monotonic() - begin_s) for name, pid in line.pids().items()}
        if dead := line.dead():
            raise RuntimeError(f"{', '.join(dead)} ended by itself")
        line.end("daemon")
        seen.at_service = counts(client)
    summary: dict[str, int] = json.loads(line.summary.read_text())["surfaces"]["soak"]
    return seen, summary


def wait_until_ready(client: httpx2.Client) -> None:
    """Return once there is a contact to give; raises RuntimeError if none comes."""
    deadline_s = time.monotonic() + 60
    while not client.get("/health/ready").is_success:
        if time.monotonic() > deadline_s:
            raise RuntimeError("the line is not ready")
        time.sleep(ASK_S)


def ask(client: httpx2.Client, truth: Truth, seen: Seen) -> None:
    """Ask once, and compare with the truth where that stands still."""
    response = client.get("/contact")
    truth.read()
    seen.asked += 1
    if not response.is_success:
        seen.problems[response.json()["type"].rpartition(":")[2]] += 1
        return
    contact = response.json()
    seen.too_old += contact["age_ms"] > STALE_MS
    moment = datetime.fromisoformat(contact["sampled_at"]).timestamp()
    if not truth.steady(moment, SETTLED_S):
        return
    load = truth.at(moment)
    if load is None:
        return
    seen.compared += 1
    if contact["state"] == "unexplained":
        seen.unexplained += 1
    elif (load[0] is not None) != (contact["state"] == "contact"):
        seen.mistaken += 1
        print(f"mistaken: {load} was told as {contact}", flush=True)
    elif load[0] is not None:
        seen.outside += not contact["position_low_mm"] <= load[0] <= contact["position_high_mm"]


def remember_memory(line: Line, seen: Seen) -> None:
    """Note the resident memory of each process."""
    for name, pid in line.pids().items():
        seen.memory_mb.setdefault(name, []).append(resident_mb(pid))


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


def status(seen: Seen) -> str:
    """Return how things stand, in a line."""
    memory = ", ".join(f"{name} {values[-1]:.1f} MB" for name, values in seen.memory_mb.items())
    return (
        f"{seen.asked} asked, {seen.problems.total()} problems, {seen.too_old} too old, "
        f"{seen.outside} of {seen.compared} outside, {seen.mistaken} mistaken, {seen.unexplained} unexplained; {memory}"
    )


def report(seen: Seen, summary: dict[str, int], minutes: float, rate_hz: int) -> str:
    """Return the table."""
    settling = summary["readings"] - sum(summary[f"samples_{end}"] for end in ("published", "dropped", "in_log"))
    rows = [
        ("readings", f"{summary['readings']:,}"),
        ("readings missed by the daemon", f"{summary['readings_lost']:,}"),
        ("readings without a sample of their own, at rest and while the filter settles", f"{settling:,}"),
        ("samples acknowledged by the service", f"{summary['samples_published']:,}"),
        ("samples dropped", f"{summary['samples_dropped']:,}"),
        ("samples left on disk", f"{summary['samples_in_log']:,}"),
        ("samples that the service took", f"{seen.at_service['accepted']:,}"),
        ("samples that the service missed", f"{seen.at_service['lost']:,}"),
        ("contacts on its record", f"{seen.at_service['events']:,}"),
        ("of them without a lift", f"{seen.at_service['not whole']:,}"),
        ("contacts asked for", f"{seen.asked:,}"),
        ("answers that were problems", ", ".join(f"{n} {kind}" for kind, n in seen.problems.items()) or "0"),
        ("contacts older than their limit", f"{seen.too_old:,}"),
        ("contacts held against the truth", f"{seen.compared:,}"),
        ("of them outside the 95 % interval", f"{seen.outside / max(1, seen.compared):.2%}"),
        ("of them contact for clear, or the other way round", f"{seen.mistaken:,}"),
        ("of them unexplained", f"{seen.unexplained:,}"),
    ]
    for name, values in seen.memory_mb.items():
        slope = np.polyfit(np.arange(len(values)), values, 1)[0] * 60 if len(values) > 2 else float("nan")
        rows.append((f"memory of {name}", f"{values[0]:.1f} to {values[-1]:.1f} MB, {slope:+.2f} MB per hour"))
    rows += [(f"processor of {name}", f"{share:.0%} of a core") for name, share in seen.processor.items()]
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    command = f"python tests/benchmarks/soak.py --minutes {minutes:g} --rate-hz {rate_hz}"
    return f"# Endurance run of {minutes:g} minutes\n\n`{command}`\n\n| | |\n|---|---|\n{table}\n"


if __name__ == "__main__":
    sys.exit(main())
