"""Measurements that others have published: the product's own way, beside learners of scikit-learn, split by place.

The data are not part of this repository. `BEAMTOUCH_REAL_DATA` names a folder with `cordchord/output_2023-11-13.txt` of
https://github.com/hathuwic/CordChord (commit 48ef313, MIT licence, 2023 Jack Hardwick): a string of 500 mm over four
optical proximity sensors, pushed at 26 places by 5 to 25 mm. It has no forces; a push stands for one.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beamtouch_models import make_scene, resolve
from beamtouch_models.arrays import Bools, Floats

FOLDER = "BEAMTOUCH_REAL_DATA"
FILE = Path("cordchord") / "output_2023-11-13.txt"
LENGTH_MM, REST_MM = 500.0, 30.0
"""Of the string, and the label of its gap at rest: the push is this less the label."""
SENSORS = 4
EFFORT = 0.25
GOAL_PERCENT, GOAL_BY_THEORY, GOAL_HELD = 1.8, 2.2, (90.0, 98.0)
CONTACTS_MM = 10.0, 490.0
"""Range of the contacts: pushes at the very ends are known at most, and not tried."""
SEEN = 0.006
"""What a sensor must show to tell where it stands: about two standard deviations of a rest."""
SEEDS = 3
"""Of the learners; their errors are means over these."""


@dataclass(frozen=True)
class Pushes:
    """Pushes on the string, each tared at the same place."""

    position_mm: Floats
    """(pushes,)"""
    push_mm: Floats
    """(pushes,)"""
    shown: Floats
    """(pushes, sensors) mean of its rows."""
    rows: tuple[Floats, ...]
    """Its rows, (rows, sensors) each."""
    rest_noise: Floats
    """(places, sensors) readings at rest, whose spread from place to place is how well a zero is known."""
    rest_mm: Floats
    """(places,)"""


def read_pushes(path: Path) -> Pushes:
    """Read the file: rows of position, gap and four readings, one push after the other."""
    lines = [line.replace(";", " ").split() for line in path.read_text(encoding="ascii").splitlines()]
    table = np.array([[float(cell) for cell in line] for line in lines if len(line) == 2 + SENSORS])
    begins = np.flatnonzero(np.any(np.diff(table[:, :2], axis=0, prepend=-1.0) != 0, axis=1))
    placed = [rows for rows in np.split(table, begins[1:]) if len(rows)]
    rest = {rows[0, 0]: rows[:, 2:].mean(axis=0) for rows in placed if rows[0, 1] == REST_MM}
    pushed = [rows for rows in placed if rows[0, 1] != REST_MM]
    shown = tuple(rest[rows[0, 0]] - rows[:, 2:] for rows in pushed)
    return Pushes(
        np.array([rows[0, 0] for rows in pushed]),
        np.array([REST_MM - rows[0, 1] for rows in pushed]),
        np.array([one.mean(axis=0) for one in shown]),
        shown,
        np.array(list(rest.values())),
        np.array(list(rest)),
    )


def moved_by_theory(sensor_mm: float, push_mm: Floats) -> Floats:
    """Return how far a straight string moves at a sensor if it is pushed by 1 at places (places,)."""
    far_mm = np.where(sensor_mm <= push_mm, push_mm, LENGTH_MM - push_mm)
    moved: Floats = np.where(sensor_mm <= push_mm, sensor_mm, LENGTH_MM - sensor_mm) / far_mm
    return moved


def stands_at(position_mm: Floats, push_mm: Floats, shown: Floats) -> float:
    """Return the place of a sensor, of every 5 mm, at which the string moves most nearly as it shows (pushes,).

    Nobody has published where the sensors stand. What a sensor shows is taken as any cubic on logarithmic scales.
    """
    is_seen = shown > SEEN
    logs = np.log(shown[is_seen])

    def missed(sensor_mm: float) -> float:
        moved = np.log(push_mm[is_seen] * moved_by_theory(sensor_mm, position_mm[is_seen]))
        return float(np.sum((moved - np.polyval(np.polyfit(logs, moved, 3), logs)) ** 2))

    places: list[float] = np.arange(5.0, LENGTH_MM, 5.0).tolist()
    return min(places, key=missed)


def theory_of(pushes: Pushes, known: Bools, names: list[str]) -> str:
    """Return a table of the string's influence by theory, with sensors where the known pushes show them to stand."""
    along_mm = np.linspace(0.0, LENGTH_MM, 251)
    columns = [
        moved_by_theory(stands_at(pushes.position_mm[known], pushes.push_mm[known], shown), along_mm)
        for shown in pushes.shown[known].T
    ]
    head = ",".join(["position_mm", *(f"{name}_mm_per_n" for name in names)])
    rows = np.column_stack([along_mm, *columns])
    return "\n".join([head, *(",".join(f"{value:.6g}" for value in row) for row in rows)])


def tried_of(pushes: Pushes, known: Bools) -> Bools:
    """Return the pushes (pushes,) that are tried: those that are not known, in the range of the contacts."""
    low, high = CONTACTS_MM
    tried: Bools = ~known & (pushes.position_mm >= low) & (pushes.position_mm <= high)
    return tried


def estimate(pushes: Pushes, calibrated: Floats, *, by_theory: bool) -> dict[str, float]:
    """Build a model of the pushes at some places; returns its errors on the others."""
    known = np.isin(pushes.position_mm, calibrated)
    at_rest = pushes.rest_noise[np.isin(pushes.rest_mm, calibrated)]
    noise = float(np.sqrt(np.mean(at_rest.var(axis=0, ddof=1))))
    names = [f"s{number}" for number in range(1, SENSORS + 1)]
    head = ",".join(["position_mm", "force_n", *(f"{name}_deflection_mm" for name in names)])
    loads = np.column_stack([pushes.position_mm, pushes.push_mm, pushes.shown])[known]
    table = "\n".join([head, *(",".join(f"{value:.6g}" for value in load) for load in loads)])
    theory = {"theory": theory_of(pushes, known, names)} if by_theory else {}
    scene = make_scene(
        measured={"influence": table, "length_mm": LENGTH_MM, "curved": True, **theory},
        contact={"force_n": [5.0, 25.0], "position_mm": list(CONTACTS_MM)},
        # Each push has a rest of its own, so that its zero is as well known as the noise says.
        sensors={"noise_mm": noise, "zero_drift_mm": 0.0},
        environment={"drift_um_per_min": 0.0},
    )
    model = resolve(scene).place().build("string", effort=EFFORT)
    order = [names.index(name) for name in model.channels]
    tried = tried_of(pushes, known)
    straight = model.straighten(pushes.shown[tried][:, order])
    answers = model.estimate(straight.deflection_mm, noise_mm=straight.noise_mm)
    truth, is_answered = pushes.position_mm[tried], answers["state"] == "contact"
    low, high = answers["position_low_mm"][is_answered], answers["position_high_mm"][is_answered]
    return {
        "noise": noise,
        "error_mm": float(np.abs(answers["position_mm"] - truth)[is_answered].mean()),
        "held": float(100 * np.mean((low <= truth[is_answered]) & (truth[is_answered] <= high))),
        "answered": float(100 * is_answered.mean()),
    }


def learn(pushes: Pushes, calibrated: Floats) -> dict[str, float]:
    """Return the mean errors [mm] of learners that were trained on all rows at some places, on the others."""
    from sklearn.ensemble import RandomForestRegressor  # noqa: PLC0415  # only `make bench` installs it
    from sklearn.neighbors import KNeighborsRegressor  # noqa: PLC0415
    from sklearn.neural_network import MLPRegressor  # noqa: PLC0415
    from sklearn.pipeline import make_pipeline  # noqa: PLC0415
    from sklearn.preprocessing import StandardScaler  # noqa: PLC0415

    known = np.isin(pushes.position_mm, calibrated)
    trained = np.concatenate([rows for rows, is_known in zip(pushes.rows, known, strict=True) if is_known])
    counts = [len(rows) for rows, is_known in zip(pushes.rows, known, strict=True) if is_known]
    places, tried = np.repeat(pushes.position_mm[known], counts), tried_of(pushes, known)
    errors: dict[str, float] = {}
    learners: tuple[tuple[str, Callable[[int], object]], ...] = (
        ("5 nearest neighbours", lambda _: KNeighborsRegressor(5)),
        ("random forest", lambda seed: RandomForestRegressor(200, random_state=seed)),
        (
            "MLP 128 x 128",
            lambda seed: MLPRegressor(
                hidden_layer_sizes=(128, 128), max_iter=2000, early_stopping=True, random_state=seed
            ),
        ),
    )
    for name, make in learners:
        off = []
        for seed in range(SEEDS):
            learner = make_pipeline(StandardScaler(), make(seed)).fit(trained, places)
            off.append(np.abs(learner.predict(pushes.shown[tried]) - pushes.position_mm[tried]).mean())
        errors[name] = float(np.mean(off))
    return errors


def run() -> list[dict[str, Any]]:
    """Return a row for each way of locating a push, with its mean error in percent of the length."""
    folder = os.environ.get(FOLDER)
    path = None if folder is None else Path(folder) / FILE
    if path is None or not path.is_file():
        return [{"name": f"skipped: {FOLDER} names no folder with {FILE}", "value": None, "unit": ""}]
    pushes = read_pushes(path)
    places = np.unique(pushes.position_mm)
    rows: list[dict[str, Any]] = []
    splits = (
        ("every second place and the last", np.union1d(places[::2], places[-1:]), False),
        ("the first place and every second from the next", np.union1d(places[:1], places[1::2]), False),
        ("every fifth place, with theory", places[::5], True),
        ("six between these, with theory", places[[1, 6, 11, 14, 19, 24]], True),
    )
    for name, calibrated, by_theory in splits:
        found = estimate(pushes, calibrated, by_theory=by_theory)
        split = f"{len(calibrated)} of {len(places)} places: {name}"
        rows += [
            {
                "name": f"{split}: beamtouch",
                "value": 100 * found["error_mm"] / LENGTH_MM,
                "unit": "% of length",
                "goal": f"at most {GOAL_BY_THEORY if by_theory else GOAL_PERCENT}",
                "mm": found["error_mm"],
                "answered %": found["answered"],
            },
            {
                "name": f"{split}: held",
                "value": found["held"],
                "unit": "%",
                "goal": "{:g} to {:g}".format(*GOAL_HELD),
            },
        ]
        rows += [
            {"name": f"{split}: {learner}", "value": 100 * error / LENGTH_MM, "unit": "% of length", "mm": error}
            for learner, error in learn(pushes, calibrated).items()
        ]
    return rows
