"""The record through faults: `python tests/benchmarks/record_faults.py --rounds 3 [--surfaces 8] [-o FILE]`.

Rigs, one daemon, three services behind HAProxy with the configuration of `deploy/`, and PostgreSQL, as processes. In
each round a service is killed, one is frozen, the database is killed, HAProxy and the daemon are restarted, and the
network is dropped. Meanwhile each surface is asked for its contact, which is held against the truth of its rig. A fresh
service without faults then gets the samples that left the daemon, in order, and both records are compared event by
event. Returns 1 if they differ.
"""

import argparse
import json
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "demo"))

import httpx2
import numpy as np
from contact_watch import Watched, watch
from plant import PlantLine
from shipped import build
from tee import Boot, Tee, boots_of

from line import Line, Surface
from service.postgres import Postgres, running
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES

ASK_S, REST_S, FROZEN_S, DROPPED_S = 0.1, 4.0, 5.0, 20.0
MAX_SAMPLES = 500
SAME = 2e-3
"""Of positions in mm and forces in N. Figures are float32, computed in batches of other sizes."""
UNLIKE = {"id", "path", "capture"}


class TeedLine(PlantLine):
    """A plant whose daemon sends through a tee."""

    tee: Tee

    def _start_daemon(self, sources: dict[str, dict[str, Any]]) -> None:
        self.tee = Tee(self.url, self.folder / "batches")
        self.tee.start()
        asked, self.url = self.url, self.tee.url
        try:
            super()._start_daemon(sources)
        finally:
            self.url = asked

    def stop(self) -> None:
        """End all processes."""
        super().stop()
        if hasattr(self, "tee"):
            self.tee.stop()


def script(path: Path, seed: int) -> Path:
    """Write loads that rest for a while, and lift."""
    rng = np.random.default_rng(seed)
    steps = [
        f"[[step]]\nseconds = 0.7\n[[step]]\nseconds = 1.3\nposition_mm = {position:.2f}\nforce_n = {force:.2f}\n"
        for position, force in zip(rng.uniform(20, 380, 20), rng.uniform(5, 20, 20), strict=True)
    ]
    path.write_text("".join(steps))
    return path


def plant(folder: Path, surfaces: int, events_url: str) -> TeedLine:
    """Return a plant that has yet to be started."""
    build(folder)
    model, config = folder / "bench.onnx", folder / "generated.toml"
    names = [f"s{number}" for number in range(surfaces)]
    still = ("--no-ringing",)
    rigs = [
        Surface(name, "modbus-tcp", script(folder / f"{name}.toml", seed), still) for seed, name in enumerate(names)
    ]
    return TeedLine(folder, SCENES / "bench.toml", model, config, rigs, events_url=events_url, services=3)


def faults(line: TeedLine, database: Postgres) -> dict[str, Callable[[int], None]]:
    """Return what is done to the plant in each round."""

    def service(number: int) -> str:
        return line.services[number % len(line.services)]

    def kill(number: int) -> None:
        line.kill(service(number))
        line.wait_for_services()

    def restart_database(_number: int) -> None:
        database.stop(signal.SIGQUIT)
        time.sleep(1)
        database.start()

    def restart_balancer(_number: int) -> None:
        line.balancer.stop()
        line.balancer.start()

    def drop_network(_number: int) -> None:
        line.tee.cut()
        time.sleep(DROPPED_S)
        line.tee.mend()

    return {
        "kill": kill,
        "freeze": lambda number: line.freeze(service(number + 1), FROZEN_S),
        "database": restart_database,
        "HAProxy": restart_balancer,
        "daemon": lambda _number: line.restart_daemon(),
        "network": drop_network,
    }


def events_of(url: str) -> list[dict[str, Any]]:
    """Return the whole record."""
    found: list[dict[str, Any]] = []
    after = ""
    with httpx2.Client(base_url=url, trust_env=False, timeout=30.0) as client:
        while True:
            answer = client.get(f"/events?limit=1000{after}")
            if not answer.is_success:
                time.sleep(1)
                continue
            page = answer.json()
            found += page["events"]
            if page["next"] is None:
                return sorted(found, key=lambda event: (event["surface"], event["touched_at"], event["kind"]))
            after = f"&after={page['next']}"


def deliver(client: httpx2.Client, surface: str, boot: Boot) -> None:
    """Give a service the samples of a boot, in order, until they are durable."""
    for run in boot.runs(MAX_SAMPLES):
        batch = {**boot.head, "samples": [boot.samples[number] for number in run], "notes": boot.notes[run[0]]}
        ask(client, surface, {**batch, "backlog": True, "oldest": run[0]})
    last = max(boot.samples)
    empty = {**boot.head, "samples": [], "backlog": True, "oldest": last}
    wait_until(lambda: (ask(client, surface, empty)["durable"] or 0) >= last, within_s=60, pause_s=0.2)


def ask(client: httpx2.Client, surface: str, batch: dict[str, Any]) -> dict[str, Any]:
    """Send a batch; return the receipt."""
    answer = client.post(f"/surfaces/{surface}/samples", json=batch)
    answer.raise_for_status()
    receipt: dict[str, Any] = answer.json()
    return receipt


class LoneService(Line):
    """A service without rigs and daemon."""

    def _start_rig(self, surface: Surface) -> dict[str, Any]:
        return {"kind": surface.kind}

    def _start_daemon(self, sources: dict[str, dict[str, Any]]) -> None:
        """There is none."""


def reference(line: PlantLine, folder: Path, sent: dict[str, list[Boot]]) -> list[dict[str, Any]]:
    """Return the record of a service that gets the samples without a fault."""
    model = folder / "bench.onnx"
    with LoneService(folder / "reference", model, model, model, line.surfaces) as lone:
        token = (lone.folder / "token").read_text()
        headers = {"Authorization": f"Bearer {token}"}
        with httpx2.Client(base_url=lone.url, trust_env=False, timeout=60.0, headers=headers) as client:
            for surface, boots in sent.items():
                for boot in boots:
                    deliver(client, surface, boot)
        time.sleep(2)
        events = events_of(lone.url)
    # No live batch tells this service that a boot is over.
    present = {boots[-1].head["boot_id"] for boots in sent.values()}
    for event in events:
        if event["end"] == "open" and event["boot_id"] not in present:
            event["end"] = "unseen"
    return events


def differences(found: list[dict[str, Any]], expected: list[dict[str, Any]]) -> list[str]:
    """Return where two records differ."""
    by_key = {(event["surface"], event["touched_at"], event["kind"]): event for event in expected}
    lines: list[str] = []
    for event in found:
        other = by_key.pop((event["surface"], event["touched_at"], event["kind"]), None)
        if other is None:
            lines.append(f"only with faults: {event}")
        elif unlike := [name for name in event if name not in UNLIKE and not is_same(event[name], other[name])]:
            figures = ", ".join(f"{name} {event[name]} for {other[name]}" for name in unlike)
            lines.append(f"{event['surface']} {event['touched_at']}: {figures}")
    return lines + [f"missing: {event}" for event in by_key.values()]


def is_same(value: object, other: object) -> bool:
    """Return whether two entries of an event are the same, within the rounding of figures."""
    if isinstance(value, float) and isinstance(other, float):
        return abs(value - other) <= SAME
    return value == other


def report(line: TeedLine, found: dict[str, Watched], sent: dict[str, list[Boot]]) -> dict[str, Any]:
    """Return the figures of answers and samples."""
    every = list(found.values())
    boots = [boot for one in sent.values() for boot in one]
    return {
        "contacts asked for": sum(one.asked for one in every),
        "longest time without a contact, by fault [s]": {
            what: round(max(one.gaps_s.get(what, 0.0) for one in every), 2) for what in sorted(every[0].gaps_s)
        },
        "contacts older than their limit": sum(len(one.too_old) for one in every),
        "contacts held against the truth": sum(one.compared for one in every),
        "of them outside the 95 % interval": sum(one.outside for one in every),
        "of them unexplained": sum(one.unexplained for one in every),
        "of them contact for clear, or the other way round": sum(len(one.mistakes) for one in every),
        "the same, without the note unsteady": sum(
            "unsteady" not in contact["notes"] for one in every for contact in one.mistakes
        ),
        "samples": sum(len(boot.samples) for boot in boots),
        "numbers that never came": sum(len(boot.missing()) for boot in boots),
        "boots": len(boots),
        "the daemon at its end": json.loads(line.summary.read_text()) if line.summary.exists() else None,
    }


def main() -> int:
    """Run; returns 1 if the records differ or a contact was too old."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--surfaces", type=int, default=8)
    parser.add_argument("--only", nargs="*", help="these faults only")
    parser.add_argument("-o", "--output", type=Path, help="write all figures and differences to this file, as JSON")
    options = parser.parse_args()
    with running() as database, tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "reference").mkdir()
        line = plant(folder, options.surfaces, database.create())
        found = {surface.name: Watched() for surface in line.surfaces}
        stop = threading.Event()
        with line:
            time.sleep(REST_S)
            threads = [
                threading.Thread(target=watch, args=(line, name, stop, one, ASK_S, lambda: line.disturbed), daemon=True)
                for name, one in found.items()
            ]
            for thread in threads:
                thread.start()
            for number in range(options.rounds):
                for what, do in faults(line, database).items():
                    if not options.only or what in options.only:
                        line.disturbed = what
                        do(number)
                        time.sleep(REST_S)
                print(f"round {number + 1} of {options.rounds}", flush=True)
            stop.set()
            for thread in threads:
                thread.join()
            line.end("daemon")
            time.sleep(REST_S)
            record = events_of(line.url)
            sent = boots_of(line.tee)
            figures = report(line, found, sent)
        unlike = differences(record, reference(line, folder, sent))
    ends = Counter(f"{event['kind']}, {event['begin']} to {event['end']}" for event in record)
    figures |= {"events": len(record), "ends": dict(ends), "differences": len(unlike)}
    print(json.dumps(figures, indent=1))
    print("\n".join(unlike[:20]))
    mistakes = [mistake for one in found.values() for mistake in one.mistakes]
    if options.output is not None:
        options.output.write_text(json.dumps({**figures, "different": unlike, "mistakes": mistakes}, indent=1))
    return 1 if unlike or figures["contacts older than their limit"] else 0


if __name__ == "__main__":
    sys.exit(main())
