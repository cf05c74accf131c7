"""A magnetic skin that others have published: the product's own way beside a learner of scikit-learn, by place.

The data are not part of this repository. `BEAMTOUCH_REAL_DATA` names a folder with `eflesh/`: the files
`20250317_134149_states.csv` and `20250317_134149_sensor_post_baselines.csv` of
https://github.com/notvenky/eFlesh (`characterization/datasets/spatial_resolution`, commit ab5ca56, MIT licence, 2025
Venkatesh Pattabiraman): a soft pad with magnets over five magnetometers of three axes, pressed to one depth at 31 x 31
places 1 mm apart, five times. It has no forces, so each press counts as 1, and the model is told 0.8 to 1.25. The
product refuses loads that contradict the others, and names them. It takes none out: this script does, as the user of a
table would, and resolves the scene again.
"""

import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beamtouch_models import Scene, make_scene, resolve
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.errors import SceneError

FOLDER = "BEAMTOUCH_REAL_DATA"
NAME = Path("eflesh") / "20250317_134149"
CHANNELS = [f"m{chip}{axis}" for chip in range(1, 6) for axis in "xyz"]
NOISE_UT = 4.0
"""About one step of the magnetometers, 2.4 to 3.9 uT."""
FORCES = [0.8, 1.25]
EFFORT = 0.01
GOAL_MM, GOAL_HELD = 0.35, (90.0, 98.0)
SHOWN = re.compile(r"under the load at \((\S+), (\S+)\) mm with 1 N, (\w+) shows (\S+)")
SEEDS = 3
"""Of the learner; its errors are means over these."""


@dataclass(frozen=True)
class Presses:
    """Presses on the skin, one after the other."""

    place_mm: Floats
    """(presses, 2) from the lower left corner."""
    shown: Floats
    """(presses, channels) in uT."""


def read_presses(folder: Path) -> Presses:
    """Read both files: time, x, y and z of each press, and time and channels."""
    states, shown = (
        np.loadtxt(folder / f"{NAME}_{what}.csv", delimiter=",") for what in ("states", "sensor_post_baselines")
    )
    place_mm = states[:, 1:3]
    return Presses(np.round(place_mm - place_mm.min(axis=0)), shown[:, 1:])


SPLITS: tuple[tuple[str, Callable[[Floats], Bools]], ...] = (
    ("the first 80 % of time, as the authors", lambda place: np.arange(len(place)) < 0.8 * len(place)),
    ("a checkerboard", lambda place: place.sum(axis=1) % 2 == 0),
    ("every second place each way", lambda place: (place % 2 == 0).all(axis=1)),
    ("a grid of 3 mm", lambda place: (place % 3 == 0).all(axis=1)),
    ("a grid of 5 mm", lambda place: (place % 5 == 0).all(axis=1)),
)


def scene_of(place_mm: Floats, shown: Floats) -> Scene:
    """Return the scene of some presses."""
    head = ",".join(["x_mm", "y_mm", "force_n", *(f"{name}_deflection_uT" for name in CHANNELS)])
    rows = np.column_stack([place_mm, np.ones(len(place_mm)), shown])
    table = "\n".join([head, *(",".join(f"{value:.6g}" for value in row) for row in rows.tolist())])
    return make_scene(
        measured={"influence": table},
        contact={"force_n": FORCES, "x_mm": [0, 30], "y_mm": [0, 30]},
        # Each press is tared by its own rest.
        sensors={"noise_mm": NOISE_UT, "zero_drift_mm": 0.0, "gain_error_percent": 0.0, "range_mm": [-2000, 2000]},
        environment={"drift_um_per_min": 0.0},
    )


def without_contradictions(place_mm: Floats, shown: Floats) -> tuple[Scene, int]:
    """Return the scene of presses without those that contradict the others, and the number of these."""
    count = len(shown)
    while True:
        scene = scene_of(place_mm, shown)
        try:
            resolve(scene)
        except SceneError as refusal:
            named = SHOWN.findall(str(refusal))
            if not named:
                raise
            for x, y, channel, value in named:
                there = (place_mm == [float(x), float(y)]).all(axis=1)
                off = np.abs(shown[:, CHANNELS.index(channel)] - float(value))
                kept = np.arange(len(shown)) != np.where(there, off, np.inf).argmin()
                place_mm, shown = place_mm[kept], shown[kept]
        else:
            return scene, count - len(shown)


def estimate(presses: Presses, known: Bools) -> dict[str, float]:
    """Build a model of the known presses; returns its errors on the others."""
    begin_s = time.process_time()
    scene, taken_out = without_contradictions(presses.place_mm[known], presses.shown[known])
    model = resolve(scene).place().build("skin", effort=EFFORT)
    built_s = time.process_time() - begin_s
    order = [CHANNELS.index(name) for name in model.channels]
    answers, truth = model.estimate(presses.shown[~known][:, order], noise_mm=NOISE_UT), presses.place_mm[~known]
    is_answered = answers["state"] == "contact"
    off_mm = np.column_stack([answers["x_mm"], answers["y_mm"]]) - truth
    held = [
        100 * np.mean(((answers[f"{axis}_low_mm"] <= true) & (true <= answers[f"{axis}_high_mm"]))[is_answered])
        for axis, true in zip("xy", truth.T, strict=True)
    ]
    return {
        "error_mm": float(np.hypot(*off_mm[is_answered].T).mean()),
        "held_x": float(held[0]),
        "held_y": float(held[1]),
        "answered": float(100 * is_answered.mean()),
        "taken out": taken_out,
        "built_s": built_s,
    }


def learn(presses: Presses, known: Bools) -> float:
    """Return the mean error [mm] of a network that was trained on the known presses, on the others."""
    from sklearn.neural_network import MLPRegressor  # noqa: PLC0415  # only `make bench` installs it
    from sklearn.pipeline import make_pipeline  # noqa: PLC0415
    from sklearn.preprocessing import StandardScaler  # noqa: PLC0415

    errors = []
    for seed in range(SEEDS):
        network = MLPRegressor(hidden_layer_sizes=(128, 128), max_iter=1000, early_stopping=True, random_state=seed)
        learner = make_pipeline(StandardScaler(), network).fit(presses.shown[known], presses.place_mm[known])
        off_mm = learner.predict(presses.shown[~known]) - presses.place_mm[~known]
        errors.append(float(np.hypot(*off_mm.T).mean()))
    return float(np.mean(errors))


def run() -> list[dict[str, Any]]:
    """Return rows for each split: the mean distance, the share of intervals that hold, and the learner's distance."""
    folder = os.environ.get(FOLDER)
    if folder is None or not Path(f"{Path(folder) / NAME}_states.csv").is_file():
        return [{"name": f"skipped: {FOLDER} names no folder with {NAME}_states.csv", "value": None, "unit": ""}]
    presses, rows = read_presses(Path(folder)), list[dict[str, Any]]()
    for name, split in SPLITS:
        known = split(presses.place_mm)
        found = estimate(presses, known)
        rows += [
            {
                "name": f"{name}: beamtouch",
                "value": found["error_mm"],
                "unit": "mm",
                "goal": f"at most {GOAL_MM}",
                "answered %": found["answered"],
                "loads taken out": found["taken out"],
                "built s": found["built_s"],
            },
            *(
                {
                    "name": f"{name}: held along {axis}",
                    "value": found[f"held_{axis}"],
                    "unit": "%",
                    "goal": "{:g} to {:g}".format(*GOAL_HELD),
                }
                for axis in "xy"
            ),
            {"name": f"{name}: MLP 128 x 128", "value": learn(presses, known), "unit": "mm"},
        ]
    return rows
