"""Contacts anywhere on a plate, over the whole line: is one of them wrong in silence?

`python tests/benchmarks/plate_contacts.py` presses 300 times on a rig of `plate-on-springs`, and asks the service
where, once each load lies still. It prints a line every 25 contacts.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share
sys.path.insert(0, str(Path(__file__).parent.parent.parent / "demo"))

from beamtouch_models import daemon_config
from beamtouch_models.runtime import load
from line import Surface
from support.programs.forked_line import rig
from support.programs.plate_line import DAMPED, LEFT, PlateLine, Pressed
from support.surfaces.plate_models import PLATE_SCENE, write_plate_model

EVERY = 25
WRONG = 2.0
"""Half-intervals from which a place is wrong, as in the challenge."""


def told(pressed: Pressed) -> str:
    """Return the figures so far."""
    count, held = len(pressed.off_mm), 100 * np.mean(pressed.held, axis=0)
    wrong = sum(one > WRONG for one in pressed.farthest)
    return (
        f"{count} answered: off by {np.mean(pressed.off_mm):.2f} mm, at most {max(pressed.off_mm):.2f} mm; held "
        f"{held[0]:.1f} % along x and {held[1]:.1f} % along y; farthest {max(pressed.farthest):.2f} half-intervals; "
        f"{wrong} wrong in silence, {len(pressed.wrong_zones)} wrong zones, {len(pressed.refused)} without an answer"
    )


def main() -> None:
    """Press as often as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--contacts", type=int, default=300)
    parser.add_argument("--rest-s", type=float, default=0.3, help="rest once the answer is clear")
    given, pressed, rng = parser.parse_args(), Pressed(), np.random.default_rng(12)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_plate_model(folder)
        model = folder / "plate.onnx"
        (folder / "built.toml").write_text(daemon_config(load(model).metadata))
        (folder / "real.toml").write_text(DAMPED)
        options = ("--modbus-tcp", "127.0.0.1:0", "--by-hand", "--imperfections", folder / "real.toml")
        sections = {"surfaces": {"plate": {"model": str(model), "zones": {"left": LEFT}}}}
        with rig(PLATE_SCENE, model, *options) as PlateLine.rig:
            surface = Surface("plate", "modbus-tcp")
            with PlateLine(folder, PLATE_SCENE, model, folder / "built.toml", [surface], sections) as line:
                for number in range(1, given.contacts + 1):
                    line.press(pressed, rng, given.rest_s)
                    if number % EVERY == 0 or number == given.contacts:
                        print(told(pressed), flush=True)


if __name__ == "__main__":
    main()
