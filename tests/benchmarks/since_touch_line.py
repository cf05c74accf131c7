"""Position against time since touch on the real line: rig, daemon and service as processes, beside the rig's truth.

`python tests/benchmarks/since_touch_line.py [--kinds modbus-tcp serial] [--touches 200] [--scene bench] [--rings]`.
Loads at random places, with random forces, lie for a second each, and half a second passes between them. The answers of
`GET /contact` are compared with the load. With `--rings`, the beam rings, from each touch and from the lift before.
"""

import argparse
import http.client
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demo"))

import numpy as np
from shipped import build

from beamtouch_models import runtime
from line import Kind, Line, Surface

LIFTED_S, REST_S = 0.5, 1.0
SINCE_MS = (0, 5, 10, 20, 45, 95, 195, 495, 950)
ASKED_S = 0.004
"""Between two answers: asking without a pause takes the processors from the device and the daemon."""
NEAR = 0.1
"""Answers count for a time since touch if theirs differs by at most this part of it, or by less than a reading."""
BEFORE_S = 1.5
"""The script begins after the service has a model, and the daemon the zeros."""


@dataclass(frozen=True)
class Touch:
    """A load that is laid on and lies for a while."""

    offset_s: float
    """From the beginning of the script."""
    position_mm: float
    force_n: float


def touches_of(model: runtime.ModelFile, number: int) -> list[Touch]:
    """Draw touches within the ranges of a model."""
    rng, ranges = np.random.default_rng(13), model.metadata.ranges
    places, forces = rng.uniform(*ranges.position_mm, number), rng.uniform(*ranges.force_n, number)
    return [
        Touch(BEFORE_S + LIFTED_S + (LIFTED_S + REST_S) * one, round(place, 2), round(force, 2))
        for one, (place, force) in enumerate(zip(places.tolist(), forces.tolist(), strict=True))
    ]


def script(touches: list[Touch]) -> str:
    """Return the rig's script, with time for the start."""
    steps = [f"[[step]]\nseconds = {BEFORE_S}\n"]
    for one in touches:
        steps.append(f"[[step]]\nseconds = {LIFTED_S}\n")
        steps.append(f"[[step]]\nseconds = {REST_S}\nposition_mm = {one.position_mm}\nforce_n = {one.force_n}\n")
    return "".join(steps)


def answers(url: str, until_s: float) -> Iterator[dict[str, Any]]:
    """Ask for the contact again and again; yield each sample's answer once."""
    connection = http.client.HTTPConnection(urlsplit(url).netloc)
    last = -1
    while time.time() < until_s:
        connection.request("GET", "/contact")
        response = connection.getresponse()
        answer = json.loads(response.read())
        if response.status == http.client.OK and answer["sequence"] != last:
            last = answer["sequence"]
            yield answer
        time.sleep(ASKED_S)


def began_s(truth: Path, touches: list[Touch]) -> float:
    """Return when the script began [s, unix]: each touch lies between two rows of the truth."""
    rows = [line.split(",") for line in truth.read_text().splitlines()[1:-1]]
    times, loaded = np.array([float(row[0]) for row in rows]), np.array([row[1] != "" for row in rows])
    starts = np.flatnonzero(loaded[1:] & ~loaded[:-1])[: len(touches)]
    offsets = np.array([one.offset_s for one in touches])
    return float((np.max(times[starts] - offsets) + np.min(times[starts + 1] - offsets)) / 2)


def run(
    kind: Kind, scene: str, number: int, folder: Path, *, rings: bool, rate_hz: int | None = None
) -> list[dict[str, float]]:
    """Run one line; returns a row per time since touch, and one of the times until the state follows."""
    model = build(folder, scene, rate_hz)
    touches = touches_of(model, number)
    (folder / "script.toml").write_text(script(touches))
    surface = Surface(scene, kind, folder / "script.toml", () if rings else ("--no-ringing",))
    seconds = touches[-1].offset_s + REST_S
    with Line(folder, folder / f"{scene}.toml", folder / f"{scene}.onnx", folder / "generated.toml", [surface]) as line:
        found = list(answers(line.url, time.time() + seconds))
        begin_s = began_s(line.truth(scene), touches)
    return [*table(found, touches, begin_s, model), follows(found, touches, begin_s)]


def table(
    found: list[dict[str, Any]], touches: list[Touch], begin_s: float, model: runtime.ModelFile
) -> list[dict[str, float]]:
    """Compare answers with the loads, by the time since the first loaded reading."""
    length_mm, reading_s = model.metadata.length_mm, 1 / model.metadata.sensor.rate_hz
    taken_s = np.array([datetime.fromisoformat(one["sampled_at"]).timestamp() for one in found])
    rows = []
    for since_ms in SINCE_MS:
        error, held, steady = [], [], []
        missed: Counter[str] = Counter()
        for touch in touches:
            # The first loaded reading comes half a reading after the load, on average.
            wanted_s = begin_s + touch.offset_s + reading_s / 2 + since_ms / 1e3
            index = int(np.argmin(np.abs(taken_s - wanted_s)))
            if abs(taken_s[index] - wanted_s) > max(reading_s / 2 + 0.0005, NEAR * since_ms / 1e3):
                continue
            answer = found[index]
            if answer["state"] != "contact":
                missed[answer["state"]] += 1
                continue
            error.append(abs(answer["position_mm"] - touch.position_mm) / length_mm * 100)
            held.append(answer["position_low_mm"] <= touch.position_mm <= answer["position_high_mm"])
            steady.append("unsteady" not in answer["notes"])
        rows.append(
            {
                "ms": since_ms,
                "answers": len(error),
                "error %": float(np.mean(error)) if error else np.nan,
                "held %": 100 * float(np.mean(held)) if held else np.nan,
                "without a note %": 100 * float(np.mean(steady)) if steady else np.nan,
                **{state: missed[state] for state in sorted(missed)},
            }
        )
    return rows


def follows(found: list[dict[str, Any]], touches: list[Touch], begin_s: float) -> dict[str, float]:
    """Return the times from a touch to the first sample that is a contact, and from a lift to the first clear one."""
    taken_s = np.array([datetime.fromisoformat(one["sampled_at"]).timestamp() for one in found])
    states = np.array([one["state"] for one in found])
    times: dict[str, list[float]] = {"contact": [], "clear": []}
    for touch in touches:
        for state, after_s in (("contact", 0.0), ("clear", REST_S)):
            since_ms = 1e3 * (taken_s - (begin_s + touch.offset_s + after_s))
            first = np.flatnonzero((since_ms > 0) & (states == state))
            if len(first):
                times[state].append(float(since_ms[first[0]]))
    return {f"{state} {part} ms": float(np.percentile(of, part)) for state, of in times.items() for part in (50, 95)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", default=["modbus-tcp", "serial"])
    parser.add_argument("--touches", type=int, default=200)
    parser.add_argument("--scene", default="bench")
    parser.add_argument("--rate-hz", type=int, help="readings per second, instead of the scene's")
    parser.add_argument("--rings", action="store_true")
    given = parser.parse_args()
    for each in given.kinds:
        with tempfile.TemporaryDirectory() as made:
            print(each)
            for row in run(each, given.scene, given.touches, Path(made), rings=given.rings, rate_hz=given.rate_hz):
                print("  ".join(f"{name} {value:.4g}" for name, value in row.items()), flush=True)
