"""Contacts on a line whose zeros drift, with what `build` writes: lost, wrong without a note, held, and what was said.

`make bench NAMES=drift` plays some courses; `python tests/benchmarks/bench_drift.py [SCENE] [--rings]` all of them, on
a beam that rings from each touch and lift, or on a still one.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from shipped import build

from beamtouch_daemon.config.file import load_config
from beamtouch_models.runtime import ModelFile, State
from system.drifting_line import Course, Line, Press, drift, knock, presses

RATES_UM_PER_MIN = (0.5, 2.0, 5.0, 20.0)
EACH_S = (1.0, 2.0, 4.0, 20.0)
USUAL_UM_PER_MIN, USUAL_S = 5.0, 2.0
PLAYED_S, HALL_S = 240.0, 3600.0
HALL_UM = 45.0
"""Amplitude of zeros that drift by 3 um/K in a hall that warms and cools by 15 K; the hour stands for a day."""
CREEPS_S = 600.0


def courses(model: ModelFile, *, every: bool) -> Iterator[tuple[str, Course]]:
    """Yield the courses with their names; not `every` one unless that is asked for."""
    channels = len(model.channels)
    second = [float(index == 1) for index in range(channels)]
    shares = {"all": [1.0] * channels, "one": second, "some": [1.0, -1.0, *[0.0] * (channels - 2)]}
    for rate in RATES_UM_PER_MIN if every else (0.0, USUAL_UM_PER_MIN):
        for who, share in shares.items() if every else [("all", shares["all"])]:
            for each_s in EACH_S if every else (USUAL_S,):
                name = f"{rate:g} um/min on {who}, a contact each {each_s:g} s"
                yield name, Course(PLAYED_S, presses(model, PLAYED_S, each_s), drift(rate, share))
    if not every:
        return
    low, high = model.metadata.ranges.position_mm
    middle, least = (low + high) / 2, model.metadata.ranges.force_n[0]
    for who in ("all", "one"):
        pressed = [Press(5.0, 605.0, middle, 4 * least)]
        yield f"a contact of ten minutes, 5 um/min on {who}", Course(625.0, pressed, drift(5.0, shares[who]))
    for um in (20.0, 50.0, 200.0):
        yield f"a knock of {um:g} um", Course(60.0, presses(model, 60.0, 4.0), knock(um, 30.0, second))
    pressed = [Press(5.0, 1205.0, middle, least, CREEPS_S)]
    yield "the smallest force creeps on in ten minutes", Course(700.0, pressed, drift(0.0, second))
    pressed = [Press(-1.0, 20.0, middle, 4 * least), *presses(model, 60.0, 4.0)[6:]]
    yield "a start under a load", Course(60.0, pressed, drift(5.0, shares["all"]))
    hall = presses(model, HALL_S, 20.0, held_s=2.0)
    yield "a hall that warms and cools", Course(HALL_S, hall, lambda at_s: _warmth(at_s)[:, None] * np.ones(channels))


def _warmth(at_s: np.ndarray) -> np.ndarray:
    warmth: np.ndarray = 1e-3 * HALL_UM * np.sin(2 * np.pi * at_s / HALL_S)
    return warmth


def run(name: str = "bench", *, every: bool = False, rings: bool = False) -> list[dict[str, object]]:
    """Play the courses on a shipped scene."""
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as folder:
        model = build(Path(folder), name)
        settings = load_config(Path(folder) / "generated.toml").surfaces[name]
        for title, course in courses(model, every=every):
            said = Line(model, settings, rings=rings).play(course)
            row: dict[str, object] = {
                "name": f"{name}, {title}: contacts lost",
                "value": float(said.lost),
                "unit": f"of {said.presses}",
                "goal": "0",
                "wrong without a note": len(said.wrong),
                "held": round(float(np.mean(said.held)), 4) if said.held else None,
                "interval mm": round(float(np.median(said.interval_mm)), 2) if said.interval_mm else None,
                "false contacts": said.false,
                "clear at rest": round(said.share(State.CLEAR), 4),
                "unexplained at rest": round(said.share(State.UNEXPLAINED), 4),
                "unexplained at": round(said.unexplained_at_s[0], 1) if said.unexplained_at_s else None,
                "gains": ", ".join(sorted(said.gains)),
                "notes": dict(said.notes),
            }
            rows.append(row)
            if every:
                print(row, flush=True)
    return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", default="bench")
    parser.add_argument("--rings", action="store_true", help="the beam rings")
    given = parser.parse_args()
    run(given.scene, every=True, rings=given.rings)
