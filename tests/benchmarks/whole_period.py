"""A whole period from the record, and contacts meanwhile: `tests/benchmarks/whole_period.py [--before CHECKOUT]`.

A service with the model of the scene `bench` and a record of 20 000 events gets a sample each 50 ms and is asked for
the contact as often, while one client takes all events as NDJSON, with paths, and as pages of CSV, each for some
seconds. Said are events per second, what 200 000 events would take, and percentiles of the time to a contact: medians
of rounds, in each of which all are measured in turns. `--before CHECKOUT` measures another checkout, too; `--busy N`
runs so many programs beside that want a core each.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))

import httpx2
from record_readers import SECTIONS, SURFACE, copy, record, sample
from serving import HERE, TOKEN, build_with, service
from shipped import build

from beamtouch_models.runtime import ModelFile

EVENTS = 20_000
ASKED = {
    "nothing": "",
    "ndjson": "format=ndjson",
    "with paths": "format=ndjson&path=true",
    "csv": "format=csv&limit=1000",
}


def count_lines(port: int, query: str, seconds: float) -> float:
    """Take events for so long, from the first again at the end; return how many came in a second."""
    begin_s, lines, address = time.monotonic(), 0, f"/events?{query}"
    with httpx2.Client(base_url=f"http://127.0.0.1:{port}", trust_env=False, timeout=60) as http:
        while True:
            with http.stream("GET", address) as answer:
                answer.raise_for_status()
                for part in answer.iter_bytes():
                    lines += part.count(b"\n")
                    if (passed_s := time.monotonic() - begin_s) > seconds:
                        return lines / passed_s
                following = answer.links.get("next", {}).get("url", f"?{query}")
            address = f"/events{following}"


@contextmanager
def busy(programs: int) -> Iterator[None]:
    """Run programs that want a core each."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(programs)]
    try:
        yield
    finally:
        for one in running:
            one.kill()
            one.wait()


def measure(folder: Path, model: ModelFile, query: str, seconds: float, checkout: Path | None) -> dict[str, Any]:
    """Return what a client of a service gets, and how long contacts take meanwhile."""
    with service(folder, SECTIONS, checkout) as (_, port):
        touched = sample(model, 0, 0)
        sent = json.dumps({"channels": model.channels} | {key: touched[key] for key in ("deflection_mm", "quality")})
        words = [sys.executable, str(HERE / "contact_probe.py"), str(port), SURFACE, str(seconds), TOKEN, sent, "clock"]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as probe:
            per_s = count_lines(port, query, seconds) if query else 0.0
            said: dict[str, Any] = json.loads(probe.communicate()[0])
    figures: dict[str, Any] = said["contact"]
    return figures | {"per_s": per_s, "late": sum(said["unanswered"].values())}


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--busy", type=int, default=0, metavar="N", help="programs beside that want a core each")
    parser.add_argument(
        "--before", type=Path, metavar="CHECKOUT", help="another checkout, to measure in turns with this"
    )
    given = parser.parse_args()
    checkouts = ({"before": given.before.resolve()} if given.before else {}) | {"now": None}
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    with TemporaryDirectory() as place:
        model = build(Path(place))
        for name, checkout in checkouts.items():
            folder = Path(place) / name
            folder.mkdir()
            build_with(checkout, folder)
            with service(folder, SECTIONS, checkout) as (_, port):
                record(port, model)
            copy(folder / "events.db", EVENTS)
        with busy(given.busy):
            for _ in range(given.rounds):
                for words, query in ASKED.items():
                    for name, checkout in checkouts.items():
                        figures = measure(Path(place) / name, model, query, given.seconds, checkout)
                        found.setdefault((words, name), []).append(figures)
    for (words, name), rounds in found.items():
        per_s, p50_ms, p99_ms = (median(one[key] for one in rounds) for key in ("per_s", "p50_ms", "p99_ms"))
        late, asked = (sum(one[key] for one in rounds) for key in ("late", "count"))
        taken = f"{per_s:.0f} events a second, 200 000 in {200_000 / per_s:.0f} s; " if per_s else ""
        print(
            f"{words}, {name}: {taken}contact {p50_ms:.1f}, {p99_ms:.1f} ms; {late:.0f} of {asked:.0f} late", flush=True
        )


if __name__ == "__main__":
    main()
