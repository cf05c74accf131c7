"""`design-sensors place`: places the sensors, and states the accuracy limit of the layout."""

import argparse
import math
import time
from typing import Any

from beamtouch_common.digits import digits
from beamtouch_models.commands.shared import shown_progress
from beamtouch_models.design.accuracy.limit import accuracy_limit, limits_with_one_failed
from beamtouch_models.design.building.remarks import missed_error, remarks
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.layout import Layout, place_sensors
from beamtouch_models.design.placement.eigenvalue_bound import largest_gap
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim, recommended_count
from beamtouch_models.design.printing import Result, note
from beamtouch_models.design.scene import load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.numbers import three_digits

LIMIT_DRAWS, LEAST_DRAWS = 10_000, 256
"""Usual and smallest number of simulated contacts."""


def run(options: argparse.Namespace) -> Result:
    """Place the sensors of a scene; the result is the layout with its score, gap and accuracy limit."""
    started = time.perf_counter()
    scene, _ = load_scene(options.scene)
    note(*remarks(scene))
    aim = aim_of(options)
    with shown_progress() as progress:
        layout = place_sensors(resolve(scene), count=options.sensors, seed=options.seed, aim=aim, progress=progress)
        progress("measuring the accuracy limit", 0.95)
        fields = _describe(layout, options.seed)
    fields["wall_s"] = time.perf_counter() - started
    note(missed_error("accuracy limit", fields["accuracy_limit_percent"], scene))
    return Result(fields, [_rows(fields, layout)])


def aim_of(options: argparse.Namespace) -> Aim:
    """Return the aim of a layout; leading components, which only `place` has, are those of the eigenvalue product.

    Raises SceneError if the options contradict each other.
    """
    leading = getattr(options, "components", None)
    usual = DEFAULT_AIM.criterion if leading is None else "eigenvalue-product"
    search = getattr(options, "search", DEFAULT_AIM.search)
    return Aim(options.criterion or usual, options.spare or 0, leading, search, Effort(options.effort))


def _describe(layout: Layout, seed: int) -> dict[str, Any]:
    """Return everything to print except the time; unknown values are None."""
    placement, surface, aim, gap = layout.placement, layout.surface, layout.aim, None
    if aim.criterion == "eigenvalue-product":
        gap = largest_gap(surface.influence, surface.rules, layout.positions_mm, aim.leading)
    # Use fresh draws: a layout looks better on the draws that it was chosen by.
    limit = accuracy_limit(layout.prior, aim.effort.of(LIMIT_DRAWS, LEAST_DRAWS), seed + 1)
    failed = limits_with_one_failed(layout.prior, limit, seed + 1, aim.effort)
    score = placement.log_eigenvalue_product
    return {
        "positions_mm": list(placement.positions_mm),
        "log_eigenvalue_product": score if math.isfinite(score) else None,
        "accuracy_limit_percent": limit.value,
        "standard_error": limit.standard_error,
        "gap": gap,
        "evaluations": placement.evaluations,
        "criterion": aim.criterion,
        "spare": aim.spare,
        "limit_without_percent": [limit_without.value for limit_without in failed],
        "limit_without_standard_error": [limit_without.standard_error for limit_without in failed],
        "search": aim.search,
        "seed": seed,
        "components": aim.leading or len(placement.positions_mm),
        "recommended_sensors": recommended_count(surface.influence, surface.errors.noise_mm),
    }


def _rows(found: dict[str, Any], layout: Layout) -> list[tuple[str, str]]:
    """Return a line per figure, each number with its unit and reference."""
    surface, positions, score = layout.surface, found["positions_mm"], found["log_eigenvalue_product"]
    leading = f"{found['components']} leading eigenvalues" if found["components"] < len(positions) else "all"
    product = "-inf: a component is below rounding" if score is None else f"{score:.4f}"
    percent, noise_mm = found["accuracy_limit_percent"], surface.errors.noise_mm
    error_mm = percent / 100 * surface.influence.diagonal_mm
    without = ", ".join(
        f"{digits(percent, 3)} % +- {digits(error, 1)} without {position:g}"
        for position, percent, error in zip(
            positions, found["limit_without_percent"], found["limit_without_standard_error"], strict=False
        )
    )
    recommended = found["recommended_sensors"]
    return [
        ("sensors", f"{', '.join(f'{position:g}' for position in positions)} mm from the left end"),
        ("product", f"ln {product} ({leading}; lengths in units of l, W/(EI) = 1)"),
        ("bound", _bound_in_words(found["gap"])),
        (
            "limit",
            f"mean error {three_digits(percent)} % +- {digits(found['standard_error'], 1)} of the length, "
            f"{digits(error_mm, 3)} mm, at {digits(noise_mm, 3)} mm noise per sample",
        ),
        *([("failed", f"mean error {without}")] if without else []),
        ("search", f"{found['search']}, by {found['criterion']}, seed {found['seed']}"),
        ("cost", f"{found['evaluations']} layouts scored, {found['wall_s']:.2f} s"),
        ("paper", f"{recommended} sensors by the paper's rule, one per component above the noise, at least two"),
    ]


def _bound_in_words(gap: float | None) -> str:
    if gap is None:
        return "none for this criterion; --criterion eigenvalue-product has one"
    if gap == 0:
        return "no layout on the grid has a larger product"
    return f"no layout on the grid scores more than {digits(gap, 3)} above this one, in ln of the product"
