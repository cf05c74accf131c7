"""Contacts on record over hours: `python tests/benchmarks/hour_of_events.py [--minutes 60] [--touches 300] [--seed 0]`.

The scene `bench` at 200 Hz, its beam ringing. The same readings become samples with `publish.rest_ms` of 0 and of 100;
a service has each stream for its record. Said are how many contacts each has, touches that are none of them (missed)
and contacts without a touch (false), how many of one lie on one of the other, how far their beginnings, ends and loads
are apart, and the size of the records. `--touches 0` is a beam at rest, `--rest-ms 100` one stream only.
"""

import argparse
import json
import sys
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))

import httpx2
import numpy as np
from rest_trade import NO_LOAD, Taking, Trade
from serving import TOKEN, service

from beamtouch_daemon.processing.filters import rest_of
from beamtouch_daemon.processing.pipeline import Pipeline, TimedSample
from beamtouch_models.lab.rig.loads import Load
from beamtouch_models.lab.rig.surface import VirtualSurface

RATE_HZ, BEGIN_UNIX_S = 200, 1.7e9
LASTS_S, FORCE_N = (0.2, 2.0), (1.0, 20.0)
IN_BATCH = 1000


def course(seconds: float, touches: int, length_mm: float) -> list[Load]:
    """Return the load of each reading: touches that begin at any time, one after the other."""
    random, loads = np.random.default_rng(0), [NO_LOAD] * round(seconds * RATE_HZ)
    share = len(loads) / max(1, touches)
    for number in range(touches):
        count = round(random.uniform(*LASTS_S) * RATE_HZ)
        begin = round((number + random.uniform(0, 0.5)) * share)
        load = Load(float(random.uniform(0.1, 0.9) * length_mm), float(random.uniform(*FORCE_N)))
        end = min(begin + count, round((number + 1) * share) - RATE_HZ, len(loads))
        loads[begin:end] = [load] * (end - begin)
    return loads


def recorded(trade: Trade, folder: Path, loads: list[Load], rest_ms: int, seed: int) -> dict[str, Any]:
    """Return the events of a service that is given the samples, how many these are, and the size of its record."""
    folder.mkdir()
    sections = f'[events]\nfile = "events.sqlite"\n[surfaces.bench]\nmodel = "{folder.parent / "bench.onnx"}"\n'
    trade.beam = VirtualSurface(trade.scene, trade.model.metadata, seed=seed)
    pipeline = Pipeline(trade.settings, rest=rest_of(trade.settings) if rest_ms else None)
    taking, waiting, sent, events = Taking(pipeline, rest_ms / 1e3, []), list[TimedSample](), 0, list[dict[str, Any]]()
    with (
        service(folder, sections) as (_, port),
        httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=300, trust_env=False) as http,
    ):
        head = {"boot_id": "benchmark-1", "channels": trade.settings.channel_names, "backlog": True, "oldest": 1}
        for number, load in enumerate(loads):
            waiting += taking.take(trade.reading(number, load))
            if len(waiting) >= IN_BATCH or number == len(loads) - 1:
                body = {**head, "samples": [one.sample.model_dump(mode="json") for one in waiting]}
                answer = http.post("/surfaces/bench/samples", json=body, headers={"Authorization": f"Bearer {TOKEN}"})
                assert answer.status_code == 200, answer.text
                sent, waiting = sent + len(waiting), []
        after: str | None = ""
        while after is not None:
            page = (http.get("/events", params={"limit": 1000} | ({"after": after} if after else {}))).json()
            events, after = events + page["events"], page["next"]
    size = sum(path.stat().st_size for path in folder.glob("events.sqlite*"))
    events.sort(key=lambda event: str(event["touched_at"]))
    return {"events": [event for event in events if event["kind"] == "contact"], "samples": sent, "MB": size / 1e6}


def seconds_of(event: dict[str, Any]) -> tuple[float, float]:
    """Return when a contact began and ended, in seconds of the course."""
    begin, end = (datetime.fromisoformat(event[key]).timestamp() for key in ("touched_at", "lifted_at"))
    return begin - BEGIN_UNIX_S, end - BEGIN_UNIX_S


def against_truth(events: list[dict[str, Any]], loads: list[Load]) -> tuple[int, int]:
    """Return how many touches are no contact on record, and how many contacts on record lie on no touch."""
    pressed = np.array([load.force_n > 0 for load in loads])
    edges = np.flatnonzero(np.diff(np.concatenate(([False], pressed, [False]))))
    begins_s, ends_s = edges[::2] / RATE_HZ, edges[1::2] / RATE_HZ
    met, false = np.zeros(len(begins_s), bool), 0
    for event in events:
        begin_s, end_s = seconds_of(event)
        on = (begins_s <= end_s) & (begin_s <= ends_s)
        met |= on
        false += not on.any()
    return int(np.sum(~met)), false


def compare(found: dict[int, dict[str, Any]]) -> dict[str, object]:
    """Return how the contacts of two streams of the same readings differ."""
    every, few = (one["events"] for one in list(found.values())[:2])
    spans = [seconds_of(event) for event in few]
    pairs, apart = 0, dict[str, list[float]]()
    for event in every:
        begin_s, end_s = seconds_of(event)
        same = [at for at, span in enumerate(spans) if span[0] < end_s and begin_s < span[1]]
        if len(same) != 1:
            continue
        pairs, other = pairs + 1, few[same[0]]
        apart.setdefault("touch ms", []).append(1e3 * abs(spans[same[0]][0] - begin_s))
        apart.setdefault("lift ms", []).append(1e3 * abs(spans[same[0]][1] - end_s))
        for key in ("mean_force_n", "peak_force_n", "mean_position_mm"):
            apart.setdefault(key, []).append(abs(other[key] - event[key]))
    quantiles = {key: np.percentile(values, (50, 90, 100)).round(2).tolist() for key, values in apart.items()}
    return {"one contact of each in the other": pairs, "apart, p50, p90 and largest": quantiles}


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--touches", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    parser.add_argument("--rest-ms", type=int, nargs="+", default=[0, 100])
    given = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        trade, found = Trade(folder, RATE_HZ), dict[int, dict[str, Any]]()
        loads = course(given.minutes * 60, given.touches, trade.scene.beam.length_mm)
        for rest_ms in given.rest_ms:
            found[rest_ms] = one = recorded(trade, folder / str(rest_ms), loads, rest_ms, given.seed)
            missed, false = against_truth(one["events"], loads)
            counts = f"{one['samples']} samples, {len(one['events'])} contacts, {missed} missed, {false} false"
            print(f"rest_ms = {rest_ms}: {counts}, {one['MB']:.2f} MB", flush=True)
    if len(found) > 1:
        print(json.dumps(compare(found), indent=1))


if __name__ == "__main__":
    main()
