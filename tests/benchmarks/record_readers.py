"""Contacts while clients read the record: `python tests/benchmarks/record_readers.py [--clients 0 1 8 40]`.

A service with the model of the scene `bench` and 4000 events with whole paths gets a sample each 50 ms and is asked for
the contact as often, while clients ask for `GET /events?path=true&limit=50` without a pause. Said are percentiles of
the time to a contact and to a receipt, contacts without an answer in time, and pages per second: medians of rounds, in
each of which all are measured in turns. `--before CHECKOUT` measures another checkout, too. The sender states no clock
with `--no-clock`, so that its samples count as old as they may be.
"""

import argparse
import json
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from contextlib import closing
from functools import reduce
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))

import httpx2
from serving import HERE, TOKEN, build_with, service, surfaces
from shipped import build

from beamtouch_models.runtime import ModelFile
from support.programs.processes import resident_mb

SURFACE, PATH = "s0", "/events?path=true&limit=50"
SECTIONS = f'[events]\nfile = "events.db"\n{surfaces([SURFACE])}'
CONTACTS, TOUCHED = 10, 400
"""Contacts that are recorded, and their samples; copies of them make the others."""
WARM_S = 2.0


def sample(model: ModelFile, row: int | None, number: int) -> dict[str, Any]:
    """Return a sample at one of the loads of the golden answers, or at rest."""
    mm = [0.0] * len(model.channels) if row is None else model.metadata.golden.deflection_mm[row]
    at_us = 1_795_218_046_000_000 + number * 5000
    return {"sequence": number, "acquired_unix_us": at_us, "deflection_mm": mm, "quality": ["good"] * len(mm)}


def record(port: int, model: ModelFile) -> None:
    """Have contacts recorded, with as many points as a path may have."""
    rows = [None if at % TOUCHED < 20 else at // TOUCHED % 3 for at in range(CONTACTS * TOUCHED + 20)]
    samples = [sample(model, row, number) for number, row in enumerate(rows, 1)]
    with httpx2.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=60) as http:
        last = None
        while last is None or last <= len(samples):
            part = samples[(last or 1) - 1 :][:200]
            batch = {"boot_id": "benchmark-0", "channels": model.channels, "samples": part, "oldest": 1}
            answer = http.post(
                f"/surfaces/{SURFACE}/samples",
                json=batch | {"backlog": True},
                headers={"Authorization": f"Bearer {TOKEN}"},
            )
            last = answer.raise_for_status().json()["expected"]


TIMES = ("touched_us", "last_us", "lifted_us")
COPY = "INSERT INTO events ({names}) SELECT {values} FROM events WHERE id <= :count"


def copy(path: Path, events: int) -> None:
    """Add copies of the events of a record, each some minutes later, until there are so many."""
    with closing(sqlite3.connect(path)) as connection:
        names = [row[1] for row in connection.execute("PRAGMA table_info(events)") if row[1] != "id"]
        values = [f'"{name}" + :later_us' if name in TIMES else f'"{name}"' for name in names]
        query = COPY.format(names=", ".join(f'"{name}"' for name in names), values=", ".join(values))
        (count,) = connection.execute("SELECT count(*) FROM events").fetchone()
        for turn in range(1, -(-events // count)):
            connection.execute(query, {"later_us": turn * 60_000_000, "count": count})
        connection.commit()


def measure(
    folder: Path, model: ModelFile, clients: int, given: argparse.Namespace, checkout: Path | None
) -> dict[str, Any]:
    """Return what readers cost a service whose record is in the folder."""
    with service(folder, SECTIONS, checkout) as (pid, port):
        words = [sys.executable, str(HERE / "http_load.py"), str(port), PATH, str(clients), str(given.seconds + WARM_S)]
        readers = subprocess.Popen(words, stdout=subprocess.PIPE, text=True) if clients else None
        time.sleep(WARM_S)
        touched = sample(model, 0, 0)
        sent = json.dumps({"channels": model.channels} | {key: touched[key] for key in ("deflection_mm", "quality")})
        words = [sys.executable, str(HERE / "contact_probe.py"), str(port), SURFACE, str(given.seconds), TOKEN, sent]
        found: dict[str, Any] = json.loads(subprocess.check_output([*words, *given.clock], text=True))
        found["pages"] = json.loads(readers.communicate()[0]) if readers else None
        return found | {"memory_mb": resident_mb(pid)}


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--events", type=int, default=4000)
    parser.add_argument("--clients", type=int, nargs="+", default=[0, 1, 8, 40])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--no-clock", dest="clock", action="store_const", const=[], default=["clock"])
    parser.add_argument(
        "--before", type=Path, metavar="CHECKOUT", help="another checkout, to measure in turns with this one"
    )
    given = parser.parse_args()
    checkouts = {"before": given.before.resolve()} if given.before else {}
    with TemporaryDirectory() as place:
        model = build(Path(place))
        folders = {name: Path(place) / name for name in (*checkouts, "now")}
        for name, folder in folders.items():
            folder.mkdir()
            build_with(checkouts.get(name), folder)
            with service(folder, SECTIONS, checkouts.get(name)) as (_, port):
                record(port, model)
            copy(folder / "events.db", given.events)
        found: dict[tuple[str, int], list[dict[str, Any]]] = {}
        for _ in range(given.rounds):
            for clients in given.clients:
                for name, folder in folders.items():
                    figures = measure(folder, model, clients, given, checkouts.get(name))
                    found.setdefault((name, clients), []).append(figures)
        for (name, clients), rounds in found.items():
            print(f"{name}, {clients} clients: {text(rounds)}", flush=True)


def text(rounds: list[dict[str, Any]]) -> str:
    """Return the figures of measurements in words."""

    def middle(*names: str) -> float:
        found: list[Any] = [reduce(dict.__getitem__, names, one) for one in rounds]
        return float(median(found))

    asked, lost = sum(one["contact"]["count"] for one in rounds), Counter[str]()
    for one in rounds:
        lost.update(one["unanswered"])
    said = [
        f"{words} {middle(name, 'p50_ms'):.1f}, {middle(name, 'p99_ms'):.1f} ms"
        for name, words in (("contact", "contact"), ("sample", "receipt"))
    ]
    said += [f"{lost.total()} of {asked} unanswered", *map(str, filter(None, [dict(lost)]))]
    said.append(f"{middle('memory_mb'):.0f} MB")
    if rounds[0]["pages"]:
        statuses = sorted({status for one in rounds for status in one["pages"]["statuses"]})
        said.append(f"{middle('pages', 'per_s'):.1f} pages a second, p50 {middle('pages', 'p50_ms'):.0f} ms")
        said.append(" ".join(statuses))
    return "; ".join(said)


if __name__ == "__main__":
    main()
