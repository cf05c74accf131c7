"""`design-sensors place`: places the sensors, and states how much better any other layout could be."""

import argparse
import json
import math
import time
from typing import Any

import numpy as np

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.building.checks import check_scene
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.commands.progress import shown_progress
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement import Placement, fewest_sensors, place, place_by_position_error, recommended_count
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.pricing.effects import required
from beamtouch_models.pricing.noise import choose_filter
from beamtouch_models.scene import Scene, load_scene
from beamtouch_models.workers import spread_over

LIMIT_DRAWS = 10_000


def run(options: argparse.Namespace) -> None:
    """Place the sensors of a scene and print the layout with its score, gap and accuracy limit."""
    started = time.perf_counter()
    stated, _ = load_scene(options.scene)
    chosen = choose_filter(stated)
    check_scene(stated, chosen, options.sensors)
    physics = required(stated, chosen)
    scene, noise_mm = physics.scene, physics.noise.sample_mm
    influence, rules, errors = influence_of(scene), sensor_rules(scene), sample_errors(scene, noise_mm)
    count = options.sensors or _count_of(scene, influence, rules, errors, options.seed)
    if options.components is not None and options.components > count:
        message = f"--components {options.components}: {count} sensors have no more than {count} components"
        raise SceneError(message)
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        if options.criterion == "position-error":
            placement = place_by_position_error(
                influence,
                rules,
                count,
                options.seed,
                errors,
                leading=options.components,
                search=options.search,
                progress=progress,
            )
        else:
            placement = place(
                influence,
                rules,
                count,
                options.seed,
                options.components,
                search=options.search,
                certify=spread if options.prove else "bound",
                progress=progress,
            )
        progress("measuring the accuracy limit", 0.95)
        found = _described(options, influence, errors, placement)
    found["wall_s"] = time.perf_counter() - started
    print(json.dumps(found, allow_nan=False) if options.json else _table(found, noise_mm))


def _count_of(scene: Scene, influence: InfluenceFunction, rules: Candidates, errors: SampleErrors, seed: int) -> int:
    """Return the number of sensors that the scene states, or the one that a build of it finds."""
    fewest, most = scene.sensors.count_range
    if fewest == most:
        return fewest
    wanted_mm = scene.requirements.position_error_mm
    found = fewest_sensors(influence, rules, (fewest, most), wanted_mm=wanted_mm, errors=errors, seed=seed)
    return len(found.positions_mm)


def _described(
    options: argparse.Namespace, influence: InfluenceFunction, errors: SampleErrors, placement: Placement
) -> dict[str, Any]:
    """Return everything to print except the time; unknown values are None."""
    prior = Prior.real(influence, np.array(placement.positions_mm), errors)
    # Use fresh draws: a layout looks better on the draws that it was chosen by.
    limit = accuracy_limit(prior, LIMIT_DRAWS, options.seed + 1)
    score = placement.log_eigenvalue_product
    return {
        "positions_mm": list(placement.positions_mm),
        "log_eigenvalue_product": score if math.isfinite(score) else None,
        "accuracy_limit_percent": limit.percent,
        "standard_error": limit.standard_error,
        "proven": placement.proven,
        "gap": placement.gap,
        "evaluations": placement.evaluations,
        "criterion": options.criterion,
        "search": options.search,
        "seed": options.seed,
        "components": options.components or len(placement.positions_mm),
        "recommended_sensors": recommended_count(influence, errors.noise_mm),
    }


def _table(found: dict[str, Any], noise_mm: float) -> str:
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
        ("limit", _limit_line(found["accuracy_limit_percent"], found["standard_error"], noise_mm)),
        ("search", f"{found['search']}, by {found['criterion']}, seed {found['seed']}"),
        ("cost", f"{found['evaluations']} layouts scored, {found['wall_s']:.2f} s"),
        ("advice", f"{found['recommended_sensors']} sensors: one per component that exceeds the noise, at least two"),
    ]
    return "\n".join(f"{label:<8} {text}" for label, text in rows)


def _limit_line(percent: float, standard_error: float, noise_mm: float) -> str:
    return f"mean error {percent:.3f} % +- {standard_error:.3f} of the length, at {noise_mm:.3g} mm noise per sample"


def _proof_line(found: dict[str, Any]) -> str:
    if found["proven"]:
        return "the best layout on the grid, proven"
    if found["gap"] is None:
        return "none: this criterion has no bound"
    return f"no layout on the grid scores more than {found['gap']:.3g} above this one, in ln of the product"
