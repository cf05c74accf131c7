"""Endurance of several services: `python tests/benchmarks/replicas.py --rounds 20 [--surfaces 24] [-o FILE]`.

Rigs, one daemon, three services behind HAProxy with the configuration of `deploy/`, and PostgreSQL, as processes. In
each round every service is killed in turn, one is frozen, and database and HAProxy are restarted. Meanwhile each is
asked for its contact, which is held against the truth of its rig. At the end come the longest time without a contact
per surface, and what the events on record say.
"""

import argparse
import signal
import sys
import tempfile
import threading
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

from beamtouch_models import modelfile
from beamtouch_models.building.build import build
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.scene import load_scene
from example_scenes import SCENES
from line import Surface, Truth
from plant import PlantLine
from postgres import Postgres, running

ASK_S, SETTLED_S, STALE_MS = 0.1, 0.2, 500.0
REST_S = 3.0
"""Between two disturbances."""
FROZEN_S = 4.0


@dataclass
class Watched:
    """What asking for one surface showed."""

    asked: int = 0
    longest_s: float = 0.0
    """Longest time between two contacts."""
    gaps_s: dict[str, float] = field(default_factory=dict)
    """The same, by what was disturbed at the end of it."""
    compared: int = 0
    outside: int = 0
    mistaken: int = 0
    too_old: int = 0
    problems: Counter[str] = field(default_factory=Counter)


def watch(line: PlantLine, name: str, stop: threading.Event, seen: Watched) -> None:
    """Ask for one surface until told to stop."""
    truth = Truth(line.truth(name))
    answered_s = time.monotonic()
    with httpx2.Client(base_url=line.url, trust_env=False, timeout=1.0) as client:
        while not stop.wait(ASK_S):
            seen.asked += 1
            try:
                response = client.get(f"/contact?surface={name}")
            except httpx2.TransportError as error:
                seen.problems[type(error).__name__] += 1
                continue
            truth.read()
            if not response.is_success:
                seen.problems[f"{response.status_code}"] += 1
                continue
            now_s = time.monotonic()
            gap_s, answered_s = now_s - answered_s, now_s
            seen.longest_s = max(seen.longest_s, gap_s)
            seen.gaps_s[line.disturbed] = max(seen.gaps_s.get(line.disturbed, 0.0), gap_s)
            compare(response.json(), truth, seen)
    truth.close()


def compare(contact: dict[str, Any], truth: Truth, seen: Watched) -> None:
    """Hold a contact against the truth where that stands still."""
    seen.too_old += contact["age_ms"] > STALE_MS
    moment = datetime.fromisoformat(contact["sampled_at"]).timestamp()
    # A replica that was frozen must not give an old sample for a new one.
    seen.too_old += time.time() - moment > STALE_MS / 1e3 + 1.0
    if not truth.steady(moment, SETTLED_S) or (load := truth.at(moment)) is None:
        return
    seen.compared += 1
    if (load[0] is not None) != (contact["state"] == "contact"):
        seen.mistaken += 1
    elif load[0] is not None:
        seen.outside += not contact["position_low_mm"] <= load[0] <= contact["position_high_mm"]


def disturb(line: PlantLine, database: Postgres, number: int) -> None:
    """Carry out one round."""
    for service in line.services:
        line.disturbed = "kill"
        line.kill(service)
        line.wait_for_services()
        time.sleep(REST_S)
    line.disturbed = "freeze"
    line.freeze(line.services[number % len(line.services)], FROZEN_S)
    time.sleep(REST_S)
    line.disturbed = "database"
    database.stop(signal.SIGINT)
    database.start()
    time.sleep(REST_S)
    line.disturbed = "HAProxy"
    line.balancer.stop()
    line.balancer.start()
    time.sleep(REST_S)


def script(path: Path, seed: int) -> Path:
    """Write loads that rest for a while, and lift."""
    rng = np.random.default_rng(seed)
    steps = [
        f"[[step]]\nseconds = 0.7\n[[step]]\nseconds = 1.3\nposition_mm = {position:.2f}\nforce_n = {force:.2f}\n"
        for position, force in zip(rng.uniform(20, 380, 20), rng.uniform(5, 20, 20), strict=True)
    ]
    path.write_text("".join(steps))
    return path


def plant(folder: Path, surfaces: int, events_url: str) -> PlantLine:
    """Return a plant that has yet to be started."""
    scene, text = load_scene(SCENES / "bench.toml")
    model, config = folder / "bench.onnx", folder / "generated.toml"
    model.write_bytes(build(scene, text, "bench", count=None, seed=0, progress=lambda _doing, _done: None).content)
    config.write_text(daemon_config(modelfile.load(model).metadata))
    names = [f"s{number}" for number in range(surfaces)]
    rigs = [Surface(name, "modbus-tcp", script(folder / f"{name}.toml", seed)) for seed, name in enumerate(names)]
    return PlantLine(folder, SCENES / "bench.toml", model, config, rigs, events_url=events_url, services=3)


def ends(url: str) -> Counter[str]:
    """Return how many contacts on record end in each way."""
    found: Counter[str] = Counter()
    after = ""
    with httpx2.Client(base_url=url, trust_env=False, timeout=30.0) as client:
        while True:
            page = client.get(f"/events?kind=contact&limit=1000{after}").json()
            found.update(f"{event['begin']} to {event['end']}" for event in page["events"])
            if page["next"] is None:
                return found
            after = f"&after={page['next']}"


def report(found: dict[str, Watched], contacts: Counter[str], rounds: int) -> str:
    """Return the table."""
    every = list(found.values())
    problems = sum((one.problems for one in every), Counter[str]())
    rows = {
        "surfaces, rounds": f"{len(found)}, {rounds}",
        "contacts asked for": f"{sum(one.asked for one in every):,}",
        "longest time without a contact, worst surface": f"{max(one.longest_s for one in every):.2f} s",
        "the same, by what was disturbed": ", ".join(
            f"{what} {max(one.gaps_s.get(what, 0.0) for one in every):.2f} s" for what in sorted(every[0].gaps_s)
        ),
        "the same, median surface": f"{np.median([one.longest_s for one in every]):.2f} s",
        "contacts older than their limit": f"{sum(one.too_old for one in every)}",
        "contacts held against the truth": f"{sum(one.compared for one in every):,}",
        "of them outside the 95 % interval": f"{sum(one.outside for one in every):,}",
        "of them contact for clear, or the other way round": f"{sum(one.mistaken for one in every)}",
        "answers that were problems": ", ".join(f"{count} {name}" for name, count in problems.items()) or "0",
        "contacts on record": ", ".join(f"{count} {name}" for name, count in contacts.most_common()),
    }
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())]) + "\n"


def main() -> int:
    """Run; returns 1 if a contact was too old."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--surfaces", type=int, default=24)
    parser.add_argument("-o", "--output", type=Path, help="write the table to this file as well")
    options = parser.parse_args()
    with running() as database, tempfile.TemporaryDirectory() as folder:
        line = plant(Path(folder), options.surfaces, database.create())
        found = {surface.name: Watched() for surface in line.surfaces}
        stop = threading.Event()
        with line:
            time.sleep(REST_S)
            threads = [
                threading.Thread(target=watch, args=(line, name, stop, one), daemon=True) for name, one in found.items()
            ]
            for thread in threads:
                thread.start()
            for number in range(options.rounds):
                disturb(line, database, number)
                print(f"round {number + 1} of {options.rounds}", flush=True)
            stop.set()
            for thread in threads:
                thread.join()
            line.end("daemon")
            time.sleep(REST_S)
            text = report(found, ends(line.url), options.rounds)
    print(text)
    if options.output is not None:
        options.output.write_text(text)
    return 1 if any(one.too_old for one in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
