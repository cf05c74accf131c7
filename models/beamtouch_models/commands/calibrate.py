"""`design-sensors calibrate`: fits a model to the real beam, using recorded loads or unlabelled contacts."""

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.files import require_writable, write_atomically
from beamtouch_models.arrays import Floats
from beamtouch_models.commands.fit_in_words import departures_in_words, each_fine, percent_of, scale_in_words
from beamtouch_models.commands.shared import require_one_axis, shown_progress
from beamtouch_models.design.building.replaced import require_model
from beamtouch_models.design.calibration.calibrate import Calibrated, CheckedFit, calibrate
from beamtouch_models.design.calibration.choice import has_one_scale
from beamtouch_models.design.calibration.doubts import common_in_words
from beamtouch_models.design.calibration.recordings import read_contacts, read_loads
from beamtouch_models.design.calibration.self_calibrate import KINDS, SelfCalibrated, self_calibrate
from beamtouch_models.design.calibration.session import DRIFTING, SHIFT, WEIGHT
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.printing import Result
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.health.changes import DRIFT
from beamtouch_models.runtime.health.residuals import LoadErrors
from beamtouch_models.runtime.loading import ModelFile

MIN_ERROR, MAX_ERROR = 1e-3, 50.0
"""Bounds of the stated errors of the loads, in mm and in percent."""

ALIKE_FORCES = 0.2
"""Range of the forces, over their mean, below which they are the same."""
SAME_FORCE = (
    "all loads have about the same force, so a weight that was forgotten would pass for a softer beam; record some "
    "loads with another force, such as half of it"
)
SCALED = 2.0
"""Standard errors from which a scale of all deflections is more than chance."""
TELL_APART = (
    "To see what scales all deflections, measure one beside a sensor with a dial gauge, under a load. If the sensor "
    "shows another, the gains are off; if it shows the same, weigh the load: if that is right, too, it is the "
    "rigidity. The model answers the same in each case, in newtons of the weights that were recorded."
)


def run(options: argparse.Namespace) -> Result:
    """Calibrate and write the model; the result is the departures with the errors or misfits before and after."""
    model = loading.load(options.model)
    if options.events is not None:
        if resolve_model(model.metadata).scene.plate is not None:
            raise InputError(
                f"{options.model}: contacts of unknown place and force do not tell the springs of a plate from gains; "
                "record known loads instead (beamtouch-daemon record), a dozen are enough"
            )
        require_one_axis(model.metadata.axes, options.model, "calibrate --events")
    require_writable([options.output], [options.readings, options.events])
    require_model(options.output)
    fit_to = _calibrate_with_loads if options.events is None else _calibrate_with_contacts
    calibrated, fields, rows, remark = fit_to(model, options)
    write_atomically(options.output, calibrated.content)
    identity, metadata = loading.load(options.output).identity, calibrated.metadata
    shown = {
        "model": identity,
        "output": str(options.output),
        "calibration": metadata.calibration and metadata.calibration.model_dump(),
        **fields,
        "accuracy": {**metadata.accuracy.model_dump(), "ratio": metadata.accuracy.ratio},
    }
    return Result(shown, [[("model", identity), *rows]], remark)


Told = tuple[Calibrated | SelfCalibrated, dict[str, Any], list[tuple[str, str]], str]
"""The result of a calibration, with fields for programs, and rows and a remark for people."""


def _calibrate_with_loads(model: ModelFile, options: argparse.Namespace) -> Told:
    """Calibrate a model with recorded loads."""
    for name in ("placing_mm", "force_percent", "mounting_mm"):
        value, option = getattr(options, name), f"--{name.replace('_', '-')}"
        if not MIN_ERROR <= value <= MAX_ERROR:  # nobody can place or weigh loads so well or so badly
            raise InputError(f"{option} {value:g} is not from {MIN_ERROR:g} to {MAX_ERROR:g}")
    load_errors = LoadErrors(options.placing_mm, options.force_percent / 100)
    loads = replace(read_loads(options.readings, model.metadata, options.leave_out), errors=load_errors)
    with shown_progress() as progress:
        calibrated = calibrate(model, loads, progress, options.mounting_mm, Effort(options.effort))
    fit, before, after, limit_mm = calibrated.fit, calibrated.before_mm, calibrated.after_mm, calibrated.limit_mm
    errors = fit.nominal.standard_errors(fit.vector, fit.spread)
    words = departures_in_words(calibrated.metadata, fit.departures, errors)
    drift, drift_errors = fit.session.rates_um_per_min(fit.vector), fit.session.rates_um_per_min(fit.spread)
    scale = _scale(calibrated)
    is_scaled = scale is not None and abs(scale[0]) > SCALED * scale[1]
    # A weight that was forgotten would show as a scale.
    if (scale is None or is_scaled) and np.ptp(loads.force_n) < ALIKE_FORCES * loads.force_n.mean():
        print(SAME_FORCE, file=sys.stderr)
    placing_mm, force_percent = fit.errors.placing_mm, 100 * fit.errors.force
    fields = {
        "standard_errors": {kind: values.tolist() for kind, values in errors.items()},
        "scale": None if scale is None else {"value": scale[0], "standard_error": scale[1]},
        "added_force_n": _common(calibrated, WEIGHT, fit.session.weight_n),
        "shift_mm": _common(calibrated, SHIFT, fit.session.shift_mm),
        "error_before_mm": {"mean": float(before.mean()), "worst": float(before.max())},
        "error_after_mm": {"mean": float(after.mean()), "worst": float(after.max())},
        "limit_mm": limit_mm,
        "placing_mm": placing_mm,
        "force_percent": force_percent,
        "drift_um_per_min": drift.tolist(),
        "loads_left_out": sorted(set(options.leave_out)),
    }
    placed = f"placed to about {digits(placing_mm, 2)} mm and with forces known to about {digits(force_percent, 2)} %"
    mean, worst = digits(after.mean(), 3), digits(after.max(), 3)
    rows = [
        ("loads", f"{len(before)}, {placed}"),
        *common_in_words(fit, calibrated.sure).items(),
        *(
            ("scale", scale_in_words(*scale)) if kind == "rigidity" and scale is not None else (kind, text)
            for kind, text in words.items()
        ),
        *(
            [("drift", f"{each_fine(calibrated.metadata, drift, drift_errors)} a minute")]
            if DRIFTING in fit.kinds
            else []
        ),
        ("before", f"{digits(before.mean(), 3)} mm mean error of these loads, {digits(before.max(), 3)} mm worst"),
        ("after", f"{mean} mm mean, {worst} mm worst, each by a fit without the load"),
        ("limit", f"{digits(limit_mm, 3)} mm mean error of single samples of these loads, at best"),
    ]
    return calibrated, fields, rows, TELL_APART if is_scaled else ""


def _scale(checked: CheckedFit) -> tuple[float, float] | None:
    """Return by how much more the beam deflects per newton than the scene says, relatively, and its standard error.

    None if loads tell the rigidity from the gains.
    """
    fit = checked.fit
    if not has_one_scale(fit):
        return None
    softer = 1 / fit.departures.rigidity
    return softer - 1, softer**2 * float(fit.nominal.standard_errors(fit.vector, fit.spread)["rigidity"][0])


def _common(checked: CheckedFit, kind: str, size_of: Callable[[Floats], float | Floats]) -> dict[str, Any] | None:
    """Return the size of a mistake that all loads share, and whether it surely is there; None if it does not show.

    On a plate, a shift has a size along each axis.
    """
    fit = checked.fit
    if kind not in fit.kinds:
        return None
    value, error = (np.squeeze(size_of(entries)).tolist() for entries in (fit.vector, fit.spread))
    return {"value": value, "standard_error": error, "is_sure": kind in checked.sure}


def _calibrate_with_contacts(model: ModelFile, options: argparse.Namespace) -> Told:
    """Calibrate a model with unlabelled contacts; says which contacts are left out, and which zeros moved."""
    contacts = read_contacts(options.events, model.metadata)
    for count, why in ((contacts.other_characteristic, "with an older characteristic"), (contacts.older, "older")):
        if count:
            print(f"{count} contacts {why} are left out; the newest {len(contacts)} are used", file=sys.stderr)
    moved = contacts.moved_zeros(np.array(model.metadata.floor.zero_mm))
    if len(moved):
        names = " and ".join(model.channels[channel] for channel in moved)
        print(
            f"the zeros of {names} moved by more than {DRIFT:g} times the stated drift, and the fit takes them as "
            "constant; fetch only the contacts since they moved, with ?since=TIME",
            file=sys.stderr,
        )
    with shown_progress() as progress:
        calibrated = self_calibrate(model, contacts, progress, Effort(options.effort))
    metadata, self_fit = calibrated.metadata, calibrated.found
    fit, remaining = self_fit.fit, self_fit.remaining
    # Errors of gains without the common scale, which is the force's.
    errors = fit.nominal.standard_errors(fit.vector, np.sqrt(np.diag(remaining.relative)))
    words = departures_in_words(metadata, fit.departures, errors)
    expected, single = float(chi2.median(fit.nominal.degrees)), float(fit.single.sum())
    open_mm = float(np.sqrt((remaining.position_mm**2).mean()))
    force = metadata.calibration.force_error if metadata.calibration else 0.0
    fields = {
        "standard_errors": {kind: values.tolist() for kind, values in errors.items() if kind in KINDS},
        "misfit": {"before": self_fit.misfit_before, "after": self_fit.misfit_after, "expected": expected},
        "changed_mm": remaining.shift_mm,
        "open_mm": open_mm,
        "single_contacts": single,
        "contacts_left_out": contacts.other_characteristic + contacts.older,
        "floor": metadata.floor.model_dump(),
    }
    misfits = f"{digits(self_fit.misfit_before, 3)} before, {digits(self_fit.misfit_after, 3)} after"
    change = f"changes by {digits(remaining.shift_mm, 3)} mm (root mean square)"
    before, after = (percent_of(floor.gain) for floor in (model.metadata.floor, metadata.floor))
    rows = [
        ("contacts", f"{len(contacts)}, of which about {len(contacts) - single:.0f} are not single contacts"),
        *((kind, words[kind]) for kind in KINDS if kind in words),
        ("misfit", f"{misfits} (medians; {digits(expected, 3)} from noise alone)"),
        ("position", f"{change}, {digits(open_mm, 3)} mm left open"),
        *([("force", f"its scale stays open by {digits(100 * force, 2)} %")] if force else []),
        ("floor", f"gains +- {before} before, +- {after} now"),
    ]
    return calibrated, fields, rows, ""
