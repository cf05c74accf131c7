"""`design-sensors evaluate`: measures a model and compares it with the accuracy limit."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models.commands.options import add_contacts, add_json, add_seed, add_workers, shown_progress
from beamtouch_models.printing import Result, Table, note, show

if TYPE_CHECKING:
    from beamtouch_models.accuracy.evaluation import Errors, Evaluation
    from beamtouch_models.accuracy.statistics import Measurement
    from beamtouch_models.loading import ModelFile


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    parser.add_argument(
        "--noise",
        type=float,
        action="append",
        default=[],
        metavar="MM",
        help="noise of a sample (standard deviation), instead of the model's; may be given several times",
    )
    add_contacts(parser, "number of simulated contacts", 16_384)
    add_workers(parser)
    add_seed(parser)
    add_json(parser)


def run(options: argparse.Namespace) -> None:
    """Evaluate at each given noise, or at the noise of the model, and print the results."""
    from beamtouch_models import loading
    from beamtouch_models.building.accuracy import evaluate
    from beamtouch_models.building.remarks import missed_requirement, remarks
    from beamtouch_models.description import unseen
    from beamtouch_models.pricing.noise import check_scale
    from beamtouch_models.scene import parse_scene
    from beamtouch_models.workers import spread_over

    model = loading.load(options.model)
    for noise_mm in options.noise:
        if not 0 <= noise_mm < math.inf:
            raise InputError(f"--noise {noise_mm:g}: give a standard deviation in mm, 0 or more")
        check_scale(noise_mm, model.metadata.max_deflection_mm)
    noises = options.noise or [model.metadata.noise.sample_mm]
    found = []
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        for noise_mm in noises:
            one = evaluate(
                model,
                noise_mm=noise_mm,
                draws=options.draws,
                seed=options.seed,
                progress=partial(progress, f"measuring at a noise of {digits(noise_mm, 3)} mm"),
                spread=spread,
            )
            found.append(one)
    scene = parse_scene(model.metadata.scene, f"the scene in {model.metadata.name}")
    note(*remarks(scene), missed_requirement(model.metadata, scene), unseen(model.metadata))
    fields = {
        "model": model.identity,
        "estimator": model.metadata.estimator,
        "evaluations": [asdict(one) for one in found],
    }
    rows = [block for one in found for block in (_table(model, one), _lines(one))]
    show(Result(fields, rows), as_json=options.json)


def _table(model: ModelFile, found: Evaluation) -> Table:
    from beamtouch_models.accuracy.statistics import Measurement

    percent = 100 / found.length_mm
    rows = []
    for label, pick in _ROWS:
        cells = []
        for errors in (found.span, found.middle):
            value = None if errors is None else pick(errors)
            scaled = value.scaled(percent) if isinstance(value, Measurement) else value and value * percent
            cells += [_text(value), _text(scaled)]
        rows.append((label, *cells))
    ratios = [_text(None if errors is None else errors.ratio) for errors in (found.span, found.middle)]
    rows.append(("error over limit", ratios[0], "", ratios[1], ""))
    noise = f"noise {digits(found.noise_mm, 3)} mm"
    title = f"{model.identity} ({model.metadata.estimator}), {noise}, {found.draws} contacts"
    return Table(("position error", "whole range, mm", "% of length", "middle 60 %, mm", "% of length"), rows, title)


_ROWS: tuple[tuple[str, Callable[[Errors], Measurement | float | None]], ...] = (
    ("mean", lambda errors: errors.mean_mm),
    ("95th percentile", lambda errors: errors.p95_mm),
    ("worst", lambda errors: errors.worst_mm),
    ("limit, mean", lambda errors: errors.limit_mean_mm),
    ("limit, 95th", lambda errors: errors.limit_p95_mm),
)


def _lines(found: Evaluation) -> list[tuple[str, str, str]]:
    """Return results other than position errors as label, value and remark, without those that the model lacks."""
    share = [
        ("position interval", found.position_coverage, "% of contacts lie inside; nominally 95 %", 100.0),
        ("its width", found.position_width_mm, "mm, mean", 1.0),
        ("force interval", found.force_coverage, "% of forces lie inside; nominally 95 %", 100.0),
        ("force error", found.force_error_n, "N, mean", 1.0),
        ("missed contacts", found.missed, "% of contacts", 100.0),
        ("unexplained", found.unexplained, "% of contacts exceed the threshold of the misfit", 100.0),
    ]
    lines = [
        (label, _text(value.scaled(factor)), remark) for label, value, remark, factor in share if value is not None
    ]
    if found.smallest_force_n is not None:
        best, worst = ("" if force is None else digits(force, 3) for force in found.smallest_force_n)
        forces = f"{best}..{worst}" if worst else f"{best} and more" if best else "-"
        lines.append(("smallest force", forces, "N, seen in 95 % of samples along the range"))
    if found.cramer_rao_mean_mm is None:
        return [*lines, ("without noise", "", "the limit is 0, so there is no ratio")]
    return [*lines, ("Cramer-Rao", digits(found.cramer_rao_mean_mm, 4), "mm, mean |error| of an unbiased estimate")]


def _text(value: Measurement | float | None) -> str:
    from beamtouch_models.accuracy.statistics import Measurement

    if value is None:
        return "-"
    if isinstance(value, Measurement):
        return f"{digits(value.value, 4)} +- {digits(value.standard_error, 2)}"
    return digits(value, 4)
