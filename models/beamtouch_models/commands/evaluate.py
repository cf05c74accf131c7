"""`design-sensors evaluate`: measures a model and compares it with the accuracy limit."""

import argparse
import math
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.units import fine
from beamtouch_models.commands.shared import shown_progress
from beamtouch_models.commands.workers import spread_over
from beamtouch_models.design.accuracy.evaluation import Evaluation
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.remarks import missed_requirement, remarks
from beamtouch_models.design.model import load_model
from beamtouch_models.design.pricing.noise import check_scale
from beamtouch_models.design.printing import Result, Table, note
from beamtouch_models.design.scene import parse_scene
from beamtouch_models.numbers import with_error
from beamtouch_models.runtime.description import unseen
from beamtouch_models.runtime.loading import ModelFile


def run(options: argparse.Namespace) -> Result:
    """Evaluate at each given noise, or at the noise of the model."""
    model = load_model(options.model)
    unit = model.metadata.unit
    for noise_mm in options.noise:
        if not 0 <= noise_mm < math.inf:
            raise InputError(f"--noise {noise_mm:g}: give a standard deviation in {unit}, 0 or more")
        check_scale(noise_mm, model.metadata.max_deflection_mm, unit)
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        evaluations = [
            model.evaluate(
                noise_mm=noise_mm,
                draws=options.draws,
                seed=options.seed,
                progress=partial(progress, f"measuring at a noise of {fine(noise_mm, unit)}"),
                spread=spread,
            )
            for noise_mm in options.noise or [model.metadata.noise.sample_mm]
        ]
    scene = parse_scene(model.metadata.scene, f"the scene in {model.metadata.name}")
    note(*remarks(scene), missed_requirement(model.metadata, scene), unseen(model.metadata))
    fields = {
        "model": model.identity,
        "estimator": model.metadata.estimator,
        "evaluations": [asdict(evaluation) for evaluation in evaluations],
    }
    return Result(
        fields, [block for evaluation in evaluations for block in (_table(model, evaluation), list(_lines(evaluation)))]
    )


def _table(model: ModelFile, found: Evaluation) -> Table:
    percent = 100 / found.length_mm
    rows = []
    for label, name in (
        ("mean", "mean_mm"),
        ("95th percentile", "p95_mm"),
        ("worst", "worst_mm"),
        ("limit, mean", "limit_mean_mm"),
        ("limit, 95th", "limit_p95_mm"),
    ):
        values = [getattr(errors, name, None) for errors in (found.span, found.middle)]
        rows.append((label, *(_text(value, scale) for value in values for scale in (1.0, percent))))
    ratios = [_text(None if errors is None else errors.ratio) for errors in (found.span, found.middle)]
    rows.append(("error over limit", ratios[0], "", ratios[1], ""))
    noise = f"noise {fine(found.noise_mm, model.metadata.unit)}"
    title = f"{model.identity}, estimator {model.metadata.estimator}: {noise}, {found.draws} simulated contacts"
    share = "% of length" if len(model.metadata.axes) == 1 else "% of diagonal"
    return Table(("position error", "whole range, mm", share, "middle 60 %, mm", share), rows, title)


def _lines(found: Evaluation) -> Iterator[tuple[str, str, str]]:
    """Yield results other than position errors as label, value and remark, without those that the model lacks."""
    for axis, share in (found.axis_coverage or {}).items():
        yield f"{axis} held", _text(share, 100.0), "% of contacts lie in their interval along this axis"
    for label, value, remark, scale in (
        (
            "position held",
            found.position_coverage,
            "% of contacts lie in their interval; it is made to hold 95 %",
            100.0,
        ),
        ("interval", found.position_width_mm, "mm from its lower to its upper end, on average", 1.0),
        ("force held", found.force_coverage, "% of forces lie in their interval; it is made to hold 95 %", 100.0),
        ("force error", found.force_error_n, "N, on average", 1.0),
        ("missed", found.missed, "% of contacts are taken for rest", 100.0),
        ("unexplained", found.unexplained, "% of contacts look like something else than one contact", 100.0),
    ):
        if value is not None:
            yield label, _text(value, scale), remark
    if found.smallest_force_n is not None:
        best, worst = ("" if force is None else digits(force, 3) for force in found.smallest_force_n)
        forces = f"{best}..{worst}" if worst else f"{best} and more" if best else "-"
        yield "smallest force", forces, "N, seen in 95 % of samples, at the best place and the worst"
    if found.cramer_rao_mean_mm is None:
        yield "without noise", "", "the limit is 0, so there is no ratio"
    else:
        bound = digits(found.cramer_rao_mean_mm, 3)
        yield "Cramer-Rao", bound, "mm, the mean error of an unbiased estimate, which knows no range of contacts"
    yield "+-", "", "a standard error"


def _text(value: Measurement | float | None, scale: float = 1.0) -> str:
    """Return a value times a scale, with its standard error if it has one."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return digits(scale * value, 3)
    return with_error(scale * value.value, scale * value.standard_error)
