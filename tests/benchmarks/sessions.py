"""Contacts on a measured structure in a later session than its loads: drift of a zero, zero tracking and more loads.

`python tests/benchmarks/sessions.py` measures a tapered leaf on rubber with known loads, and plays twenty minutes of
contacts through daemon and service. All sensors are tared at the beginning. From then on, the zero of one sensor drifts
evenly by a part of what it shows under a contact, as a root mean square. A row is what settled samples of the contacts
said: how many had an answer, how many of these had no note, and how far off these were.
"""

import argparse
import sys
import tempfile
from dataclasses import replace
from enum import StrEnum
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np

from beamtouch_common.outline import BEAM_AXIS
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_models import change_scene, daemon_config, load_model, resolve
from beamtouch_models.design.physics.measured_structure import MeasuredStructure
from beamtouch_models.design.physics.place_table import PlaceTable
from beamtouch_models.places import positions_of
from beamtouch_models.runtime import ModelFile, State
from beamtouch_service.surfaces.follower import Decision
from support.surfaces.tapered_leaf import influence, loads_csv, scene_of
from system.drifting_line import SETTLED_S, Course, Line, Said, presses

SESSION_S, EACH_S, HELD_S = 1200.0, 20.0, 5.0
RATE_HZ, LATENCY_MS = 5, 600
DRIFT_UM_PER_MIN = 40.0
"""As the scene states it."""
PARTS = (0.1, 0.5, 1.5)
"""Drifts of one zero over the session, in parts of what a contact shows."""
FARTHER_MM = 0.6
"""Farthest drift that zero tracking follows in the third way."""
DRIFTING = 1
"""The channel."""
EFFORT = 0.25


class Way(StrEnum):
    """What is done about the drift."""

    TARE = "one tare"
    TRACKS = "zero tracking as built"
    FARTHER = "zero tracking that follows farther"


class LeafLine(Line):
    """A line of the leaf itself, not of its table; it notes how far off the settled samples are."""

    def __init__(self, model: ModelFile, folder: Path, way: Way) -> None:
        (folder / "daemon.toml").write_text(daemon_config(model.metadata))
        settings = load_config(folder / "daemon.toml").surfaces[model.metadata.name]
        tracking = settings.zero_tracking
        assert tracking is not None  # the scene states a drift
        farther = tracking.model_copy(update={"max_mm": FARTHER_MM})
        chosen = {Way.TARE: None, Way.TRACKS: tracking, Way.FARTHER: farther}[way]
        super().__init__(model, settings.model_copy(update={"zero_tracking": chosen}))
        structure = self._world.structure
        assert isinstance(structure, MeasuredStructure)  # the scene has a table
        (at_mm,) = structure.ticks_mm
        true = PlaceTable([at_mm], influence(positions_of(structure.sensor_mm), at_mm))
        self._world = replace(self._world, structure=replace(structure, mean=true))
        self.samples, self.noted, self.off_mm, self.is_held = 0, 0, list[float](), list[bool]()

    def _judge(self, said: Said, course: Course, taken: TimedSample, decision: Decision) -> None:
        super()._judge(said, course, taken, decision)
        at_s = taken.monotonic_s
        touching = [press for press in course.presses if press.begin_s + 1 <= at_s <= press.end_s - SETTLED_S]
        self.samples += len(touching)
        if not touching or decision.figures is None:
            return
        if decision.notes(self.model) or taken.notes:
            self.noted += 1
            return
        mm, low, high = decision.figures.place[BEAM_AXIS]
        self.off_mm.append(abs(mm - touching[0].position_mm))
        self.is_held.append(low <= touching[0].position_mm <= high)


def play(model: ModelFile, part: float, way: Way) -> str:
    """Return the row of a session."""
    touched = presses(model, SESSION_S, EACH_S, held_s=HELD_S)
    places_mm, forces_n = (np.array([getattr(one, name) for one in touched]) for name in ("position_mm", "force_n"))
    shown_mm = forces_n * influence(model.metadata.layout_mm, places_mm)[:, DRIFTING]
    far_mm = part * float(np.sqrt(np.mean(shown_mm**2)))
    drifting = np.arange(len(model.channels)) == DRIFTING
    course = Course(SESSION_S, touched, lambda at_s: far_mm * at_s[:, None] / SESSION_S * drifting)
    with tempfile.TemporaryDirectory() as folder:
        line = LeafLine(model, Path(folder), way)
        said = line.play(course)
    answered = len(line.off_mm) + line.noted
    off_mm, held = (float(np.mean(of)) if of else np.nan for of in (line.off_mm, line.is_held))
    return (
        f"{100 * answered / line.samples:.0f} % answered, "
        f"{100 * len(line.off_mm) / line.samples:.0f} % without a note, "
        f"these {off_mm:.2f} mm off, {100 * held:.1f} % held; drift {far_mm:.3f} mm, {said.false} false contacts, "
        f"{100 * said.share(State.CLEAR):.0f} % clear at rest, {dict(said.notes)}"
    )


def main() -> None:
    """Print a row for each session."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loads", type=int, nargs="+", default=[12, 50])
    parser.add_argument("--parts", type=float, nargs="+", default=PARTS)
    given = parser.parse_args()
    for loads in given.loads:
        scene = change_scene(
            scene_of(influence=loads_csv(loads)),
            sensors={"rate_hz": RATE_HZ},
            requirements={"latency_ms": LATENCY_MS},
            environment={"drift_um_per_min": DRIFT_UM_PER_MIN},
        )
        with tempfile.TemporaryDirectory() as folder:
            resolve(scene).place().build("leaf", effort=EFFORT).save(Path(folder) / "leaf.onnx")
            model = load_model(Path(folder) / "leaf.onnx")
        for part in given.parts:
            for way in Way:
                print(f"{loads} loads, {part:g} of a signal, {way}: {play(model, part, way)}", flush=True)


if __name__ == "__main__":
    main()
