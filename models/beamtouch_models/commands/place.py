"""`design-sensors place`: places the sensors, and states the accuracy limit of the layout."""

import argparse
import math
from typing import Any

from beamtouch_common.digits import digits
from beamtouch_common.units import fine
from beamtouch_models.commands.shared import shown_progress
from beamtouch_models.design.accuracy.limit import accuracy_limit, limits_with_one_failed
from beamtouch_models.design.building.compared import EQUAL, PAPERS, TAKEN, Compared, compare_layout
from beamtouch_models.design.building.remarks import missed_error, remarks
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.layout import Layout, place_sensors
from beamtouch_models.design.placement.eigenvalue_bound import largest_gap
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim, recommended_count
from beamtouch_models.design.placement.reasons import in_parts
from beamtouch_models.design.printing import Result, note
from beamtouch_models.design.scene import load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.numbers import rounded, with_error
from beamtouch_models.places import in_words
from beamtouch_models.runtime.description import SOUGHT

ROUND = 1
"""Digits of a position of a layout that is only compared."""
LIMIT_DRAWS, LIMIT_DRAWS_OF_PLATE, LEAST_DRAWS = 10_000, 2_000, 256
"""Usual numbers of simulated contacts of a beam and of a plate, whose limit scatters less, and the smallest."""


def run(options: argparse.Namespace) -> Result:
    """Place the sensors of a scene; the result is the layout with its score, gap and accuracy limit."""
    scene, _ = load_scene(options.scene)
    note(*remarks(scene))
    aim = aim_of(options)
    with shown_progress() as progress:
        layout = place_sensors(resolve(scene), count=options.sensors, seed=options.seed, aim=aim, progress=progress)
        progress("measuring the accuracy limit", 0.9)
        compared = compare_layout(layout, options.seed)
        fields = _describe(layout, compared, options.seed)
    note(missed_error("accuracy limit", fields["accuracy_limit_percent"], scene))
    return Result(fields, [_rows(fields, compared, layout)])


def aim_of(options: argparse.Namespace) -> Aim:
    """Return the aim of a layout; leading components, which only `place` has, are those of the eigenvalue product.

    Raises SceneError if the options contradict each other.
    """
    leading = getattr(options, "components", None)
    usual = DEFAULT_AIM.criterion if leading is None else "eigenvalue-product"
    search = getattr(options, "search", DEFAULT_AIM.search)
    return Aim(options.criterion or usual, options.failed_percent, leading, search, Effort(options.effort))


def _describe(layout: Layout, compared: Compared, seed: int) -> dict[str, Any]:
    """Return everything to print; unknown values are None."""
    placement, surface, aim, gap = layout.placement, layout.surface, layout.aim, None
    if aim.criterion == "eigenvalue-product" and surface.rules.axes == 1:
        gap = largest_gap(surface.influence, surface.rules, layout.positions_mm, aim.leading)
    # Use fresh draws: a layout looks better on the draws that it was chosen by.
    draws = LIMIT_DRAWS if surface.rules.axes == 1 else LIMIT_DRAWS_OF_PLATE
    limit = accuracy_limit(layout.prior, aim.effort.of(draws, LEAST_DRAWS), seed + 1)
    failed = limits_with_one_failed(layout.prior, limit, seed + 1, aim.effort)
    score = placement.log_eigenvalue_product
    return {
        "positions_mm": layout.positions_mm.tolist(),
        "log_eigenvalue_product": score if math.isfinite(score) else None,
        "accuracy_limit_percent": limit.value,
        "standard_error": limit.standard_error,
        "gap": gap,
        "evaluations": placement.evaluations,
        "criterion": aim.criterion,
        "failed_percent": aim.failed_percent,
        "limit_without_percent": [limit_without.value for limit_without in failed],
        "limit_without_standard_error": [limit_without.standard_error for limit_without in failed],
        "reasons": list(compared.reasons),
        "compared": [
            {
                "layout": name,
                "positions_mm": compared.positions_mm[name].tolist(),
                "error_mm": costs.all_mm,
                "inner_mm": costs.inner_mm,
                "ends_mm": costs.ends_mm,
                "failed_mm": costs.failed_mm,
            }
            for name, costs in compared.costs.items()
        ],
        "search": aim.search,
        "seed": seed,
        "components": aim.leading or len(placement.place_mm),
        "recommended_sensors": recommended_count(surface.influence, surface.errors.noise_mm),
    }


def _rows(found: dict[str, Any], compared: Compared, layout: Layout) -> list[tuple[str, str]]:
    """Return a line per figure, each number with its unit and reference."""
    surface, positions = layout.surface, found["positions_mm"]
    origin, whole = ("left end", "length") if surface.rules.axes == 1 else ("lower left corner", "diagonal")
    mm, noise_mm = surface.influence.diagonal_mm / 100, surface.errors.noise_mm
    percent, recommended = found["accuracy_limit_percent"], found["recommended_sensors"]
    limit = with_error(percent * mm, found["standard_error"] * mm, unit=" mm")
    share = rounded(percent, found["standard_error"])
    without = "; ".join(
        f"at {in_words(position)} mm: {with_error(value * mm, error * mm, unit=' mm')}"
        for position, value, error in zip(
            positions, found["limit_without_percent"], found["limit_without_standard_error"], strict=False
        )
    )
    percent_failed = found["failed_percent"]
    failed = f", with the worst sensor failed {percent_failed:g} % of the time" if percent_failed else ""
    return [
        ("sensors", f"{', '.join(map(in_words, positions))} mm from the {origin}"),
        (
            "limit",
            f"mean error {limit} ({share} % of the {whole}), the best possible with these sensors, at "
            f"{fine(noise_mm, surface.scene.unit)} noise per sample",
        ),
        *([("failed", f"mean error without the sensor {without}")] if without else []),
        *zip(layout.channels, compared.reasons, strict=True),
        ("error", in_parts(compared.costs[TAKEN])),
        *(
            (key, f"{', '.join(map(in_words, compared.positions_mm[name].round(ROUND)))} mm: {in_parts(costs)}")
            for key, name in (("papers", PAPERS), ("equal", EQUAL))
            if (costs := compared.costs.get(name))
        ),
        *([("instead", compared.offer)] if compared.offer else []),
        ("placed", f"for {SOUGHT[found['criterion']]}{failed}; search {found['search']}, seed {found['seed']}"),
        *(_product_rows(found) if found["criterion"] == "eigenvalue-product" else []),
        ("paper", f"{recommended} sensors by the paper's rule, one per component above the noise, at least two"),
        (
            "+-",
            "a standard error; lines without it share contacts of their own, so that an error may differ by some "
            "percent from that above",
        ),
    ]


def _product_rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the criterion's value, and the bound on how much better another layout could be."""
    score, gap = found["log_eigenvalue_product"], found["gap"]
    some = found["components"] < len(found["positions_mm"])
    factors = f"the {found['components']} leading eigenvalues" if some else "all eigenvalues"
    product = "-inf, as a component is below rounding" if score is None else f"{score:.4f}"
    bound = (
        "not known on a plate"
        if gap is None
        else "no layout on the grid has a larger product"
        if gap == 0
        else f"no layout on the grid has a logarithm more than {digits(gap, 3)} above this one"
    )
    return [
        (
            "product",
            f"ln {product}: the logarithm of the product of {factors}; larger is better (lengths over that of the "
            "beam, W/(EI) = 1)",
        ),
        ("bound", bound),
    ]
