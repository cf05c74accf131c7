"""`design-sensors calibrate`: fits a model to the real beam, using recorded loads or unlabelled contacts."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.files import require_writable, write_atomically
from beamtouch_models import loading
from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.calibrate import Calibrated, calibrate
from beamtouch_models.calibration.errors import RecordingErrors
from beamtouch_models.calibration.fit import Fit
from beamtouch_models.calibration.loads import read_loads
from beamtouch_models.commands import calibrate_events
from beamtouch_models.commands.departures import departures_in_words
from beamtouch_models.commands.progress import shown_progress

MIN_ERROR, MAX_ERROR = 1e-3, 50.0
"""Bounds of the stated errors of the loads, in mm and in percent."""


def run(options: argparse.Namespace) -> None:
    """Calibrate, write the model, and print the departures and the errors before and after."""
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
    if options.json:
        print(
            json.dumps({"model": fresh.identity, "output": str(options.output), **_results(found, options.leave_out)})
        )
        return
    print("\n".join(f"{label:<10} {text}" for label, text in _lines(found, fresh.identity)))


def _errors(placing_mm: float, force_percent: float) -> RecordingErrors:
    """Return the stated errors of the loads; InputError if nobody can place or weigh loads so well or so badly."""
    for option, value in (("--placing-mm", placing_mm), ("--force-percent", force_percent)):
        if not MIN_ERROR <= value <= MAX_ERROR:
            message = f"{option} {value:g} is not from {MIN_ERROR:g} to {MAX_ERROR:g}"
            raise InputError(message)
    return RecordingErrors(placing_mm, force_percent / 100)


def _results(found: Calibrated, left_out: Sequence[int]) -> dict[str, object]:
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


def _lines(found: Calibrated, identity: str) -> list[tuple[str, str]]:
    shown = departures_in_words(found.metadata, found.fit.departures, _standard_errors(found.fit))
    return [
        ("model", identity),
        (
            "loads",
            f"{len(found.before_mm)}, placed to about {digits(found.fit.errors.placing_mm, 2)} mm and with forces "
            f"known to about {digits(100 * found.fit.errors.force, 2)} %",
        ),
        *((kind, text if kind in found.fit.kinds else "as in the scene") for kind, text in shown.items()),
        (
            "before",
            f"{digits(found.before_mm.mean(), 3)} mm mean error of these loads, {digits(found.before_mm.max(), 3)} mm "
            "worst",
        ),
        (
            "after",
            f"{digits(found.after_mm.mean(), 3)} mm mean, {digits(found.after_mm.max(), 3)} mm worst, each by a fit "
            "without the load",
        ),
        ("limit", f"{digits(found.limit_mm, 3)} mm mean error of single samples of these loads, at best"),
    ]


def _standard_errors(fit: Fit) -> dict[str, Floats]:
    return fit.theory.standard_errors(fit.vector, fit.spread)
