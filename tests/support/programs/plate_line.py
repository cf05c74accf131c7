"""The line of a plate beside a rig on which a test presses, and contacts that are pressed one after another."""

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beamtouch_models.arrays import Floats
from line import Surface
from support.programs.forked_line import ForkedLine, Rig
from support.running.waiting import wait_until

SIZE_MM, RIM_MM, FORCE_N = np.array([400.0, 300.0]), 10.0, (2.0, 20.0)
PATIENCE_S = 60.0
DAMPED = "damping_ratio = 0.1\n"
"""Imperfections of the rig: the plate rings at 23 Hz, and is still within half a second."""
LEFT = {"x_mm": [0, 200], "y_mm": [0, 300]}
"""A zone: the left half."""


@dataclass
class Pressed:
    """Contacts that were pressed, and what was said of them once they lay still."""

    off_mm: list[float] = field(default_factory=list)
    """Distance of the place from the truth."""
    held: list[list[bool]] = field(default_factory=list)
    """Whether the interval along each axis holds the truth."""
    farthest: list[float] = field(default_factory=list)
    """Distance from the truth along an axis over the half-interval, the larger of both."""
    refused: list[dict[str, Any]] = field(default_factory=list)
    """Answers that were still none, or a doubt."""
    wrong_zones: list[dict[str, Any]] = field(default_factory=list)
    """Answers of which a zone says the opposite of the truth."""

    def add(self, found: dict[str, Any], place_mm: Floats) -> None:
        """Add an answer to a load at a place (2,)."""
        if not is_settled(found):
            self.refused.append(found)
            return
        ends = np.array([[found[f"{axis}{end}_mm"] for end in ("", "_low", "_high")] for axis in ("x", "y")])
        middle, low, high = ends.T
        self.off_mm.append(float(np.hypot(*(middle - place_mm))))
        self.held.append(((low <= place_mm) & (place_mm <= high)).tolist())
        self.farthest.append(float((np.abs(middle - place_mm) / ((high - low) / 2)).max()))
        said = found["zones"]["left"]
        if said != "unsure" and (said == "inside") != (place_mm[0] <= LEFT["x_mm"][1]):
            self.wrong_zones.append(found)


class PlateLine(ForkedLine):
    """Service and daemon beside a rig on which the test presses."""

    rig: Rig

    def _start_rig(self, surface: Surface) -> dict[str, Any]:
        return {"kind": surface.kind, "host": "127.0.0.1", "port": int(self.rig.place)}

    def settled(self) -> dict[str, Any]:
        """Return the contact once its load rests, or what there is after some seconds."""
        end_s = time.monotonic() + PATIENCE_S
        while not is_settled(found := self.contact()) and time.monotonic() < end_s:
            time.sleep(0.02)  # the pace of a client
        return found

    def press(self, pressed: Pressed, rng: np.random.Generator, rest_s: float = 0.0) -> None:
        """Lift what lies there, let the plate rest once it is clear, press anywhere, and add what is said of it."""
        self.rig.put("")
        wait_until(lambda: self.contact().get("state") == "clear", pause_s=0.02)
        time.sleep(rest_s)  # of the plate: the world waits here, not the test
        place_mm, force_n = rng.uniform(RIM_MM, SIZE_MM - RIM_MM), rng.uniform(*FORCE_N)
        self.rig.put(f"{place_mm[0]:.4f} {place_mm[1]:.4f} {force_n:.4f}")
        pressed.add(self.settled(), place_mm)


def is_settled(found: dict[str, Any]) -> bool:
    """Return whether a load rests; a busy machine may not keep the rate of the device."""
    return found.get("state") == "contact" and set(found["notes"]) <= {"rate"}
