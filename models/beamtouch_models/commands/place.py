"""`design-sensors place`: places the sensors, and states how much better any other layout could be."""

import argparse
import json
import math
import sys
import time
from typing import Any

from beamtouch_common.digits import digits
from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.building.failing import placed_of
from beamtouch_models.building.placed import PlacedSensors, placed
from beamtouch_models.building.remarks import missed_error, remarks
from beamtouch_models.commands.aims import aim_of_place
from beamtouch_models.commands.progress import shown_progress
from beamtouch_models.placement import Aim, recommended_count
from beamtouch_models.pricing.noise import choose_filter
from beamtouch_models.scene import load_scene

LIMIT_DRAWS = 10_000


def run(options: argparse.Namespace) -> None:
    """Place the sensors of a scene and print the layout with its score, gap and accuracy limit."""
    started = time.perf_counter()
    scene, _ = load_scene(options.scene)
    for remark in remarks(scene):
        print(f"note:    {remark}", file=sys.stderr)
    aim = aim_of_place(options)
    with shown_progress() as progress:
        sensors = placed(
            scene, choose_filter(scene), count=options.sensors, seed=options.seed, aim=aim, progress=progress
        )
        progress("measuring the accuracy limit", 0.95)
        found = _described(sensors, aim, options.seed)
    found["wall_s"] = time.perf_counter() - started
    if missed := missed_error("accuracy limit", found["accuracy_limit_percent"], scene):
        print(f"note:    {missed}", file=sys.stderr)
    print(json.dumps(found, allow_nan=False) if options.json else _table(found, sensors))


def _described(sensors: PlacedSensors, aim: Aim, seed: int) -> dict[str, Any]:
    """Return everything to print except the time; unknown values are None."""
    placement = sensors.placement
    # Use fresh draws: a layout looks better on the draws that it was chosen by.
    limit = accuracy_limit(sensors.prior, LIMIT_DRAWS, seed + 1)
    failed = placed_of(sensors.prior, aim.criterion, aim.spare, seed + 1).limit_without_percent
    score = placement.log_eigenvalue_product
    return {
        "positions_mm": list(placement.positions_mm),
        "log_eigenvalue_product": score if math.isfinite(score) else None,
        "accuracy_limit_percent": limit.percent,
        "standard_error": limit.standard_error,
        "proven": placement.proven,
        "gap": placement.gap,
        "evaluations": placement.evaluations,
        "criterion": aim.criterion,
        "spare": aim.spare,
        "limit_without_percent": failed,
        "search": aim.search,
        "seed": seed,
        "components": aim.leading or len(placement.positions_mm),
        "recommended_sensors": recommended_count(sensors.influence, sensors.errors.noise_mm),
    }


def _table(found: dict[str, Any], sensors: PlacedSensors) -> str:
    """Return the result as text, each number with its unit and reference."""
    score = found["log_eigenvalue_product"]
    leading = (
        f"{found['components']} leading eigenvalues" if found["components"] < len(found["positions_mm"]) else "all"
    )
    product = "-inf: a component is below rounding" if score is None else f"{score:.4f}"
    rows = [
        ("sensors", f"{', '.join(f'{position:g}' for position in found['positions_mm'])} mm from the left end"),
        ("product", f"ln {product} ({leading}; lengths in units of l, W/(EI) = 1)"),
        ("proof", _proof_line(found)),
        ("limit", _limit_line(found["accuracy_limit_percent"], found["standard_error"], sensors)),
        *([("failed", _failed_line(found))] if found["limit_without_percent"] else []),
        ("search", f"{found['search']}, by {found['criterion']}, seed {found['seed']}"),
        ("cost", f"{found['evaluations']} layouts scored, {found['wall_s']:.2f} s"),
        ("advice", f"{found['recommended_sensors']} sensors: one per component that exceeds the noise, at least two"),
    ]
    return "\n".join(f"{label:<8} {text}" for label, text in rows)


def _limit_line(percent: float, standard_error: float, sensors: PlacedSensors) -> str:
    error_mm, noise_mm = percent / 100 * sensors.influence.length_mm, sensors.errors.noise_mm
    return (
        f"mean error {percent:.3f} % +- {digits(standard_error, 1)} of the length, {digits(error_mm, 3)} mm, at "
        f"{digits(noise_mm, 3)} mm noise per sample"
    )


def _failed_line(found: dict[str, Any]) -> str:
    pairs = zip(found["positions_mm"], found["limit_without_percent"], strict=True)
    without = ", ".join(f"{digits(percent, 3)} % without {position:g}" for position, percent in pairs)
    return f"mean error {without}"


def _proof_line(found: dict[str, Any]) -> str:
    if found["proven"]:
        return "the best layout on the grid, proven"
    if found["gap"] is None:
        return "none: this criterion has no bound"
    return f"no layout on the grid scores more than {digits(found['gap'], 3)} above this one, in ln of the product"
