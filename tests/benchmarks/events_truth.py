"""Events against truth: `python tests/benchmarks/events_truth.py [--contacts 300] [--loads still steps slide ramp]`.

The scene of the README, its beam ringing: loads at random places of the scene's range, with random forces, for 0.2 to
2 s, half a second to three seconds apart. The readings of the rig's surface go through the daemon's filters to a
service, as a backlog, and its events are compared with the loads. With `--gains`, each sensor's gain is off by as much
as the model allows for, drawn anew for every 30 contacts. `--checkout` measures the service of another one. `--line`
is a smaller run of loads that lie still: rig, daemon and service as processes, in real time.
"""

import argparse
import json
import re
import sqlite3
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demo"))

import httpx2
import numpy as np
from rest_trade import NO_LOAD, Taking
from serving import TOKEN, service
from since_touch_line import REST_S, began_s, script, touches_of

import beamtouch_models
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.processing.filters import rest_of
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.loads import Load
from beamtouch_models.lab.rig.surface import Imperfections, VirtualSurface
from beamtouch_models.runtime import ModelFile
from line import Line, Surface

README = Path(__file__).parent.parent.parent / "README.md"
BEGIN_UNIX_S, QUIET_S = 1.7e9, 3.0
LASTS_S, APART_S, RAMP_S, SLIDE_MM = (0.2, 2.0), (0.5, 3.0), (0.03, 0.2), (40.0, 360.0)
BETWEEN_S = 0.1
"""Time between the samples of a beam at rest, `publish.rest_ms` of the daemon."""
TOGETHER = 30
IN_BATCH = 1000
ASK_S, LATE_S = 0.1, 5.0
"""Time between two questions what is durable, and the longest until all of a line is."""
Truth = tuple[float, list[Load]]
"""When a load was laid on [s], and what it was at each reading."""


@dataclass(frozen=True)
class Files:
    """The scene of the README, its model, and the configuration of its daemon."""

    scene: Path
    model: Path
    daemon: Path
    loaded: ModelFile

    @classmethod
    def build(cls, folder: Path) -> "Files":
        """Write them into a folder."""
        stated = re.search(r"cat > bench.toml <<'END'\n(.*?)END\n", README.read_text(), re.DOTALL)
        assert stated
        scene, model, daemon = folder / "bench.toml", folder / "bench.onnx", folder / "daemon.toml"
        scene.write_text(stated[1])
        built = beamtouch_models.resolve(beamtouch_models.read_scene(scene)).place().build("bench")
        built.save(model)
        daemon.write_text(beamtouch_models.daemon_config(built.metadata))
        return cls(scene, model, daemon, built)


def load_of(kind: str, count: int, model: ModelFile, random: np.random.Generator) -> list[Load]:
    """Return a load at each of so many readings."""
    ranges, share = model.metadata.ranges, np.linspace(0, 1, count)
    places, forces = np.array(random.uniform(*ranges.position_mm, 2)), np.array(random.uniform(*ranges.force_n, 2))
    part = (share >= 0.5 if kind == "steps" else share if kind == "slide" else 0 * share).astype(float)
    if kind == "slide":
        places, forces[1] = random.uniform(*SLIDE_MM, 2), forces[0] * random.uniform(0.7, 1.3)
    place_mm, force_n = places[0] + part * (places[1] - places[0]), forces[0] + part * (forces[1] - forces[0])
    if kind == "ramp":
        ramp = round(random.uniform(*RAMP_S) * model.metadata.sensor.rate_hz)
        steps = np.arange(count) + 1
        force_n = force_n * np.minimum(1, np.minimum(steps, steps[::-1]) / ramp)
    return [Load(float(place), float(force)) for place, force in zip(place_mm, force_n, strict=True)]


def course(kind: str, contacts: int, model: ModelFile, seed: int) -> tuple[list[Load], list[Truth]]:
    """Return the load of each reading, and the loads that were laid on."""
    random, rate_hz = np.random.default_rng(seed), model.metadata.sensor.rate_hz
    loads, truth = [NO_LOAD] * round(QUIET_S * rate_hz), list[Truth]()
    for _ in range(contacts):
        load = load_of(kind, round(random.uniform(*LASTS_S) * rate_hz), model, random)
        truth.append((len(loads) / rate_hz, load))
        loads += load + [NO_LOAD] * round(random.uniform(*APART_S) * rate_hz)
    return loads, truth


def samples_of(files: Files, loads: list[Load], seed: int, *, gains: bool) -> list[dict[str, Any]]:
    """Return the samples of a daemon."""
    scene, _ = load_scene(files.scene)
    settings, metadata = load_config(files.daemon).surfaces["bench"], files.loaded.metadata
    off = np.random.default_rng(seed).normal(1, metadata.floor.gain).tolist() if gains else ()
    beam = VirtualSurface(scene, metadata, seed, Imperfections(gain=tuple(off)))
    period_s, found = 1 / metadata.sensor.rate_hz, list[dict[str, Any]]()
    taking = Taking(Pipeline(settings, rest=rest_of(settings)), BETWEEN_S, [])
    for number, load in enumerate(loads):
        at_s = number * period_s
        taken = taking.take(Reading(at_s, tuple(beam.counts(load, at_s))))
        found += [one.sample.model_dump(mode="json") for one in taken]
    return found


def all_events(http: httpx2.Client) -> list[dict[str, Any]]:
    """Return all events, oldest first."""
    events, after = list[dict[str, Any]](), dict[str, str]()
    while True:
        page = http.get("/events", params={"limit": 1000, **after}).json()
        events += page["events"]
        if page["next"] is None:
            return sorted(events, key=lambda event: str(event["touched_at"]))
        after = {"after": page["next"]}


def used_bytes(path: Path) -> int:
    """Return the size of the used part of a record."""
    with closing(sqlite3.connect(path)) as connection:
        pages, free, size = (
            connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count", "page_size")
        )
    return int((pages - free) * size)


def recorded(folder: Path, files: Files, runs: list[list[dict[str, Any]]], checkout: Path | None) -> tuple[Any, float]:
    """Return the events of a service for each run of samples, and the bytes of its record for an event."""
    sections = f'[events]\nfile = "events.sqlite"\n[surfaces.bench]\nmodel = "{files.model}"\n'
    channels = load_config(files.daemon).surfaces["bench"].channel_names
    with (
        service(folder, sections, checkout) as (_, port),
        httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=300, trust_env=False) as http,
    ):
        size = used_bytes(folder / "events.sqlite")
        for number, samples in enumerate(runs):
            head = {"boot_id": f"benchmark-{number:03}", "channels": channels, "backlog": True, "oldest": 1}
            receipt: dict[str, int | None] = {"expected": 1, "durable": 0}
            while (receipt["durable"] or 0) < len(samples):
                at = receipt["expected"] or 1
                part = samples[at - 1 :][:IN_BATCH]
                answer = http.post(
                    "/surfaces/bench/samples",
                    json={**head, "samples": part},
                    headers={"Authorization": f"Bearer {TOKEN}"},
                )
                assert answer.status_code == 200, answer.text
                receipt = answer.json()
                if not part:
                    time.sleep(ASK_S)
        events = all_events(http)
        size -= used_bytes(folder / "events.sqlite")
    boots = [[event for event in events if event["boot_id"] == f"benchmark-{number:03}"] for number in range(len(runs))]
    return boots, -size / max(1, len(events))


def seconds(event: dict[str, Any], name: str, begin_unix_s: float) -> float:
    """Return a time of an event in the course [s]."""
    return datetime.fromisoformat(event[name]).timestamp() - begin_unix_s


@dataclass(frozen=True)
class Pair:
    """A load with its event."""

    event: dict[str, Any]
    place_mm: float
    mean_n: float
    largest_n: float
    lasts_s: float


def pairs_of(
    events: list[dict[str, Any]], truth: list[Truth], rate_hz: float, begin_unix_s: float = BEGIN_UNIX_S
) -> list[Pair]:
    """Return the loads that have one event, which is of no other load. The ramps of a load are not the load."""
    contacts = [event for event in events if event["kind"] == "contact" and event["lifted_at"]]
    spans = [
        (seconds(event, "touched_at", begin_unix_s), seconds(event, "lifted_at", begin_unix_s)) for event in contacts
    ]
    found = []
    for begin_s, load in truth:
        end_s = begin_s + len(load) / rate_hz
        own = [at for at, (first_s, last_s) in enumerate(spans) if first_s < end_s and begin_s - 0.02 < last_s]
        if len(own) != 1 or sum(_meets(one, spans[own[0]], rate_hz) for one in truth) > 1:
            continue
        place_mm, force_n = (np.array([getattr(one, name) for one in load]) for name in ("position_mm", "force_n"))
        whole = force_n >= 0.999 * force_n.max() if len(np.unique(place_mm)) == 1 else np.ones(len(load), bool)
        pair = Pair(contacts[own[0]], place_mm[whole].mean(), force_n[whole].mean(), force_n.max(), len(load) / rate_hz)
        found.append(pair)
    return found


def _meets(truth: Truth, span: tuple[float, float], rate_hz: float) -> bool:
    """Return whether an event lasts into a load: by more than 50 ms at its begin, as the beam may still swing then."""
    begin_s, load = truth
    return begin_s < span[1] - 0.05 and span[0] < begin_s + len(load) / rate_hz


def compare(pairs: Sequence[Pair], loads: int) -> dict[str, object]:
    """Return how events differ from their loads."""

    def quantiles(values: list[float]) -> list[float]:
        return np.percentile(values, (50, 95)).round(3).tolist() if values else []

    def held(name: str, unit: str, truth: str) -> float | None:
        low, high = f"{name}_low_{unit}", f"{name}_high_{unit}"
        inside = [one.event[low] <= getattr(one, truth) <= one.event[high] for one in pairs if low in one.event]
        return round(100 * float(np.mean(inside)), 1) if inside else None

    def ratios(name: str, truth: str) -> list[float]:
        return [one.event[name] / getattr(one, truth) for one in pairs if one.event.get(name) is not None]

    force = "mean_force_n" if pairs and "mean_force_n" in pairs[0].event else "peak_force_n"
    placed = [abs(one.event["mean_position_mm"] - one.place_mm) for one in pairs if one.event["mean_position_mm"]]
    off = [abs(ratio - 1) for ratio in ratios(force, "mean_n")]
    return {
        "loads with one event": f"{len(pairs)} of {loads}",
        "position off, p50 p95 mm": quantiles(placed),
        "off by more than 25 mm": int(np.sum(np.array(placed) > 25)),
        "position held %": held("mean_position", "mm", "place_mm"),
        "force off, p50 p95": quantiles(off),
        "off by more than 30 %": int(np.sum(np.array(off) > 0.3)),
        "mean force held %": held("mean_force", "n", "mean_n"),
        "largest force over true, p50 p95": quantiles(ratios("peak_force_n", "largest_n")),
        "largest force held %": held("peak_force", "n", "largest_n"),
        "duration off, p50 p95 ms": quantiles([abs(one.event["dwell_ms"] - 1e3 * one.lasts_s) for one in pairs]),
    }


def run(kind: str, given: argparse.Namespace, files: Files, folder: Path) -> dict[str, object]:
    """Return the row of one kind of loads."""
    folder.mkdir()
    parts = [TOGETHER] * (given.contacts // TOGETHER) if given.gains else [given.contacts]
    courses = [course(kind, part, files.loaded, given.seed + 1 + number) for number, part in enumerate(parts)]
    runs = [samples_of(files, loads, given.seed + at, gains=given.gains) for at, (loads, _) in enumerate(courses)]
    boots, event_bytes = recorded(folder, files, runs, given.checkout)
    rate_hz = files.loaded.metadata.sensor.rate_hz
    pairs = [
        pair for (_, truth), events in zip(courses, boots, strict=True) for pair in pairs_of(events, truth, rate_hz)
    ]
    return compare(pairs, sum(parts)) | {"bytes an event": round(event_bytes)}


def run_line(contacts: int, files: Files, folder: Path) -> dict[str, object]:
    """Return the row of a real line."""
    touches = touches_of(files.loaded, contacts)
    (folder / "script.toml").write_text(script(touches))
    surface = Surface("bench", "modbus-tcp", folder / "script.toml", ())
    with Line(folder, files.scene, files.model, files.daemon, [surface]) as line:
        time.sleep(touches[-1].offset_s + REST_S + LATE_S)  # the script plays in real time
        begin_s = began_s(line.truth("bench"), touches)
        with httpx2.Client(base_url=line.url, timeout=60, trust_env=False) as http:
            events = all_events(http)
    rate_hz = files.loaded.metadata.sensor.rate_hz
    loads = [[Load(one.position_mm, one.force_n)] * round(REST_S * rate_hz) for one in touches]
    truth = [(one.offset_s, load) for one, load in zip(touches, loads, strict=True)]
    return compare(pairs_of(events, truth, rate_hz, begin_s), contacts)


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--contacts", type=int, default=300)
    parser.add_argument("--loads", nargs="+", default=["still"], choices=["still", "steps", "slide", "ramp"])
    parser.add_argument("--gains", action="store_true")
    parser.add_argument("--seed", type=int, default=0, help="of other loads, gains and noise")
    parser.add_argument("--checkout", type=Path)
    parser.add_argument("--line", action="store_true")
    given = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        files = Files.build(folder)
        rows = {"line": run_line(given.contacts, files, folder)} if given.line else {}
        for kind in [] if given.line else given.loads:
            rows[kind] = run(kind, given, files, folder / kind)
        for title, row in rows.items():
            print(title, json.dumps(row, indent=1), flush=True)


if __name__ == "__main__":
    main()
