"""Endurance of several services: `python tests/benchmarks/replicas.py --rounds 20 [--surfaces 24] [-o FILE]`.

Rigs, one daemon, three services behind HAProxy with the configuration of `deploy/`, and PostgreSQL, as processes. In
each round every service is killed in turn, one is frozen, and database and HAProxy are restarted. Meanwhile each is
asked for its contact, which is held against the truth of its rig. At the end come the longest time without a contact
per surface, and what the events on record say.
"""

import argparse
import json
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import TypeVar

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "demo"))

import httpx2
import numpy as np
from plant_watch import Watched, watch

from beamtouch_models import modelfile
from beamtouch_models.building.build import build_model
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.scene import load_scene
from example_scenes import SCENES
from line import Surface
from plant import PlantLine
from postgres import Postgres, running

AnyPlant = TypeVar("AnyPlant", bound=PlantLine)
REST_S = 3.0
"""Between two disturbances."""
FROZEN_S = 4.0


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


def plant(folder: Path, surfaces: int, events_url: str, kind: type[AnyPlant]) -> AnyPlant:
    """Return a plant that has yet to be started."""
    scene, text = load_scene(SCENES / "bench.toml")
    model, config = folder / "bench.onnx", folder / "generated.toml"
    model.write_bytes(
        build_model(scene, text, "bench", count=None, seed=0, progress=lambda _doing, _done: None).content
    )
    config.write_text(daemon_config(modelfile.load(model).metadata))
    names = [f"s{number}" for number in range(surfaces)]
    still = ("--no-ringing",)
    rigs = [
        Surface(name, "modbus-tcp", script(folder / f"{name}.toml", seed), still) for seed, name in enumerate(names)
    ]
    return kind(folder, SCENES / "bench.toml", model, config, rigs, events_url=events_url, services=3)


def ends(url: str) -> Counter[str]:
    """Return how many contacts on record end in each way, once the services answer."""
    found: Counter[str] = Counter()
    after = ""
    with httpx2.Client(base_url=url, trust_env=False, timeout=30.0) as client:
        while True:
            answer = client.get(f"/events?kind=contact&limit=1000{after}")
            if not answer.is_success:
                # A busy machine: HAProxy has just found no service in time.
                time.sleep(REST_S)
                continue
            page = answer.json()
            found.update(f"{event['begin']} to {event['end']}" for event in page["events"])
            if page["next"] is None:
                return found
            after = f"&after={page['next']}"


def report(found: dict[str, Watched], contacts: Counter[str], rounds: int) -> dict[str, str]:
    """Return the figures."""
    every = list(found.values())
    problems = sum((one.problems for one in every), Counter[str]())
    return {
        "surfaces, rounds": f"{len(found)}, {rounds}",
        "contacts asked for": f"{sum(one.asked for one in every):,}",
        "longest time without a contact, worst surface": f"{max(one.longest_s for one in every):.2f} s",
        "the same, by what was disturbed": ", ".join(
            f"{what} {max(one.gaps_s.get(what, 0.0) for one in every):.2f} s" for what in sorted(every[0].gaps_s)
        ),
        "the same, median surface": f"{np.median([one.longest_s for one in every]):.2f} s",
        "contacts older than their limit": f"{sum(len(one.too_old) for one in every)}",
        "contacts held against the truth": f"{sum(one.compared for one in every):,}",
        "of them outside the 95 % interval": f"{sum(one.outside for one in every):,}",
        "of them contact for clear, or the other way round": f"{sum(len(one.mistakes) for one in every)}",
        "answers that were problems": ", ".join(f"{count} {name}" for name, count in problems.items()) or "0",
        "contacts on record": ", ".join(f"{count} {name}" for name, count in contacts.most_common()),
    }


def main() -> int:
    """Run; returns 1 if a contact was too old."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--surfaces", type=int, default=24)
    parser.add_argument("-o", "--output", type=Path, help="write the figures and every mistake to this file, as JSON")
    options = parser.parse_args()
    with running() as database, tempfile.TemporaryDirectory() as folder:
        line = plant(Path(folder), options.surfaces, database.create(), PlantLine)
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
            rows = report(found, ends(line.url), options.rounds)
    print("\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())]))
    if options.output is not None:
        mistakes = [mistake for one in found.values() for mistake in one.mistakes]
        too_old = [contact for one in found.values() for contact in one.too_old]
        options.output.write_text(json.dumps({**rows, "mistakes": mistakes, "too old": too_old}, indent=1))
    return 1 if any(one.too_old for one in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
