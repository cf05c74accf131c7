"""`design-sensors evaluate`: measures a model and compares it with the accuracy limit."""

import argparse
import json
import math
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models import loading
from beamtouch_models.accuracy.evaluation import Errors, Evaluation, at_noise, evaluate
from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.building.model_prior import prior_of_model
from beamtouch_models.building.remarks import missed_requirement, remarks
from beamtouch_models.commands.progress import shown_progress
from beamtouch_models.description import nothing_seen, unseen
from beamtouch_models.pricing.noise import check_scale
from beamtouch_models.scene import parse_scene
from beamtouch_models.workers import spread_over

WIDTH_WITHOUT_TERMINAL = 120


def run(options: argparse.Namespace) -> None:
    """Evaluate at each given noise, or at the noise of the model, and print the results."""
    model = loading.load(options.model)
    for noise_mm in options.noise:
        if not 0 <= noise_mm < math.inf:
            message = f"--noise {noise_mm:g}: give a standard deviation in mm, 0 or more"
            raise InputError(message)
        check_scale(noise_mm, model.metadata.max_deflection_mm)
    prior = prior_of_model(model.metadata)
    noises = options.noise or [prior.noise_mm]
    found = []
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        for noise_mm in noises:
            one = evaluate(
                model,
                at_noise(prior, noise_mm),
                draws=options.draws,
                seed=options.seed,
                progress=partial(progress, f"measuring at a noise of {digits(noise_mm, 3)} mm"),
                spread=spread,
            )
            found.append(one)
    scene = parse_scene(model.metadata.scene, f"the scene in {model.metadata.name}")
    for remark in (*remarks(scene), missed_requirement(model.metadata, scene), unseen(model.metadata)):
        if remark:
            print(f"note:    {remark}", file=sys.stderr)
    if options.json:
        figures = [_json(one) for one in found]
        print(json.dumps({"model": model.identity, "estimator": model.metadata.estimator, "evaluations": figures}))
        return
    console = Console(width=None if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL)
    for one in found:
        _show(console, model, one)


def _json(found: Evaluation) -> dict[str, Any]:
    """Return all results, with the errors also in percent of the length."""
    fields = asdict(found)
    for name, errors in (("span", found.span), ("middle", found.middle)):
        if errors is not None:
            percent = 100 / found.length_mm
            fields[name] |= {
                "mean_percent": asdict(errors.mean_mm.scaled(percent)),
                "p95_percent": asdict(errors.p95_mm.scaled(percent)),
                "worst_percent": errors.worst_mm * percent,
                "limit_mean_percent": errors.limit_mean_mm and asdict(errors.limit_mean_mm.scaled(percent)),
            }
    return fields


def _show(console: Console, model: loading.ModelFile, found: Evaluation) -> None:
    noise = f"noise {digits(found.noise_mm, 3)} mm"
    title = f"{model.identity} ({model.metadata.estimator}), {noise}, {found.draws} contacts"
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left")
    table.add_column("position error")
    for heading in ("whole range, mm", "% of length", "middle 60 %, mm", "% of length"):
        table.add_column(heading, justify="right")
    percent = 100 / found.length_mm
    for label, pick in _ROWS:
        cells = []
        for errors in (found.span, found.middle):
            value = None if errors is None else pick(errors)
            scaled = value.scaled(percent) if isinstance(value, Measurement) else value and value * percent
            cells += [_text(value), _text(scaled)]
        table.add_row(label, *cells)
    ratios = [_text(None if errors is None else errors.ratio) for errors in (found.span, found.middle)]
    table.add_row("error over limit", ratios[0], "", ratios[1], "")
    console.print(table)
    for label, text, remark in _lines(found, model):
        console.print(f" {label:<18} {text}  {remark}".rstrip(), highlight=False)


_ROWS: tuple[tuple[str, Callable[[Errors], Measurement | float | None]], ...] = (
    ("mean", lambda errors: errors.mean_mm),
    ("95th percentile", lambda errors: errors.p95_mm),
    ("worst", lambda errors: errors.worst_mm),
    ("limit, mean", lambda errors: errors.limit_mean_mm),
    ("limit, 95th", lambda errors: errors.limit_p95_mm),
)


def _lines(found: Evaluation, model: loading.ModelFile) -> list[tuple[str, str, str]]:
    """Return results other than position errors as label, value and remark, without those that the model lacks."""
    share = [
        ("position interval", found.position_coverage, "% of contacts lie inside; nominally 95 %", 100.0),
        ("its width", found.position_width_mm, "mm, mean", 1.0),
        ("force interval", found.force_coverage, "% of forces lie inside; nominally 95 %", 100.0),
        ("force error", found.force_error_n, "N, mean", 1.0),
        ("missed contacts", found.missed, "% of contacts", 100.0),
        ("unexplained", found.unexplained, "% of contacts exceed the threshold of the misfit", 100.0),
        ("false contacts", found.false_alarms, "samples a day at rest", 86_400 * model.metadata.sensor.rate_hz),
    ]
    lines = [
        (label, _text(value.scaled(factor)), remark) for label, value, remark, factor in share if value is not None
    ]
    if found.smallest_force_n is not None and found.detection is not None:
        best, worst = ("" if force is None else digits(force, 3) for force in found.smallest_force_n)
        forces = f"{best}..{worst}" if worst else f"{best} and more" if best else "-"
        needed = list(zip(found.detection.position_mm, found.detection.smallest_force_n, strict=True))
        words = "N, seen in 95 % of samples along the range", nothing_seen(model.metadata, needed)
        lines.append(("smallest force", forces, "; ".join(filter(None, words))))
        most = 100 * max(found.detection.missed)
        lines.append(
            ("missed at most", digits(most, 3), f"% of samples of {found.detection.force_n:g} N, where it is worst")
        )
    if found.cramer_rao_mean_mm is None:
        return [*lines, ("without noise", "", "the limit is 0, so there is no ratio")]
    return [*lines, ("Cramer-Rao", digits(found.cramer_rao_mean_mm, 4), "mm, mean |error| of an unbiased estimate")]


def _text(value: Measurement | float | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, Measurement):
        return f"{digits(value.value, 4)} +- {digits(value.standard_error, 2)}"
    return digits(value, 4)
