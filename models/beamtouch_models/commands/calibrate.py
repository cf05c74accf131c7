"""`design-sensors calibrate`: fits a model to the real beam, using recorded loads or unlabelled contacts."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamtouch_common.commands import whole_number
from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.files import require_writable, write_atomically
from beamtouch_models.commands.options import add_json, shown_progress
from beamtouch_models.commands.printing import Result, show

if TYPE_CHECKING:
    from beamtouch_models.arrays import Floats
    from beamtouch_models.calibration.calibrate import Calibrated
    from beamtouch_models.calibration.fit import Fit
    from beamtouch_models.calibration.loads import RecordingErrors

MIN_ERROR, MAX_ERROR = 1e-3, 50.0
"""Bounds of the stated errors of the loads, in mm and in percent."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "readings", type=Path, nargs="?", metavar="READINGS.csv", help="loads recorded by `beamtouch-daemon record`"
    )
    source.add_argument(
        "--events",
        type=Path,
        metavar="FILE",
        help="instead: contacts of unknown place and force, from the service's /surfaces/NAME/calibration-data (CSV)",
    )
    parser.add_argument(
        "--leave-out",
        type=whole_number(0, 2**31 - 1),
        action="append",
        default=[],
        metavar="LOAD",
        help="number of a recorded load to ignore; may be given several times",
    )
    for name, metavar, text in (
        ("--placing-mm", "MM", "standard deviation of a load's true position from the stated one, in mm (default: 1)"),
        (
            "--force-percent",
            "P",
            "standard deviation of a load's true force from the stated one, in percent (default: 1)",
        ),
    ):
        parser.add_argument(name, type=float, default=1.0, metavar=metavar, help=text)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MODEL", help="model file to write (.onnx)")
    add_json(parser)


def run(options: argparse.Namespace) -> None:
    """Calibrate, write the model, and print the departures and the errors before and after."""
    from beamtouch_models import loading
    from beamtouch_models.calibration.calibrate import calibrate
    from beamtouch_models.calibration.loads import read_loads
    from beamtouch_models.commands import calibrate_events

    model = loading.load(options.model)
    require_writable([options.output], [options.readings, options.events])
    if options.events is not None:
        calibrate_events.run(model, options)
        return
    errors = _errors(options.placing_mm, options.force_percent)
    loads = replace(read_loads(options.readings, model.metadata, options.leave_out), errors=errors)
    with shown_progress() as progress:
        found = calibrate(model, loads, progress)
    write_atomically(options.output, found.content)
    fresh = loading.load(options.output)
    results = _results(found, options.leave_out)
    fields = {"model": fresh.identity, "output": str(options.output), **results}
    show(Result(fields, [_rows(found, fresh.identity)]), as_json=options.json)


def _results(found: Calibrated, left_out: Sequence[int]) -> dict[str, Any]:
    metadata = found.metadata
    calibration = metadata.calibration
    return {
        "calibration": None if calibration is None else calibration.model_dump(),
        "standard_errors": {name: values.tolist() for name, values in _standard_errors(found.fit).items()},
        "error_before_mm": {"mean": float(found.before_mm.mean()), "worst": float(found.before_mm.max())},
        "error_after_mm": {"mean": float(found.after_mm.mean()), "worst": float(found.after_mm.max())},
        "limit_mm": found.limit_mm,
        "placing_mm": found.fit.errors.placing_mm,
        "force_percent": 100 * found.fit.errors.force,
        "loads_left_out": sorted(set(left_out)),
        "accuracy": {**metadata.accuracy.model_dump(), "ratio": metadata.accuracy.ratio},
    }


def _rows(found: Calibrated, identity: str) -> list[tuple[str, str]]:
    from beamtouch_models.commands.calibrate_events import departures_in_words

    before, after = found.before_mm, found.after_mm
    shown = departures_in_words(found.metadata, found.fit.departures, _standard_errors(found.fit))
    return [
        ("model", identity),
        (
            "loads",
            f"{len(before)}, placed to about {digits(found.fit.errors.placing_mm, 2)} mm and with forces "
            f"known to about {digits(100 * found.fit.errors.force, 2)} %",
        ),
        *((kind, text if kind in found.fit.kinds else "as in the scene") for kind, text in shown.items()),
        (
            "before",
            f"{digits(before.mean(), 3)} mm mean error of these loads, {digits(before.max(), 3)} mm worst",
        ),
        (
            "after",
            f"{digits(after.mean(), 3)} mm mean, {digits(after.max(), 3)} mm worst, each by a fit without the load",
        ),
        ("limit", f"{digits(found.limit_mm, 3)} mm mean error of single samples of these loads, at best"),
    ]


def _errors(placing_mm: float, force_percent: float) -> RecordingErrors:
    """Return the stated errors of the loads; InputError if nobody can place or weigh loads so well or so badly."""
    from beamtouch_models.calibration.loads import RecordingErrors

    for option, value in (("--placing-mm", placing_mm), ("--force-percent", force_percent)):
        if not MIN_ERROR <= value <= MAX_ERROR:
            message = f"{option} {value:g} is not from {MIN_ERROR:g} to {MAX_ERROR:g}"
            raise InputError(message)
    return RecordingErrors(placing_mm, force_percent / 100)


def _standard_errors(fit: Fit) -> dict[str, Floats]:
    return fit.theory.standard_errors(fit.vector, fit.spread)
