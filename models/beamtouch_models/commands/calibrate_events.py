"""`design-sensors calibrate --events`: fits a model to the real beam, using contacts of unknown place and force."""

import argparse
import sys

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.files import write_atomically
from beamtouch_models import loading
from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.contacts import UnlabelledContacts, read_contacts
from beamtouch_models.calibration.self_calibrate import KINDS, SelfCalibrated, self_calibrate
from beamtouch_models.commands.options import shown_progress
from beamtouch_models.commands.printing import Result, show
from beamtouch_models.health.zeros import DRIFT
from beamtouch_models.loading import ModelFile
from beamtouch_models.metadata import Departures, Metadata


def departures_in_words(metadata: Metadata, found: Departures, errors: dict[str, Floats]) -> dict[str, str]:
    """Return each kind of departure with its standard errors, as text.

    Parameters
    ----------
    metadata : the model, for the names of its channels
    found : the departures
    errors : their standard errors by kind, in the units of the departures
    """
    names = [channel.name for channel in metadata.layout]

    def each(values: list[float], spread: Floats, factor: float = 1.0, centre: float = 0.0) -> str:
        return ", ".join(
            f"{name} {(value - centre) * factor:+.2f} +- {error * factor:.2f}"
            for name, value, error in zip(names, values, spread, strict=True)
        )

    shown = {
        "rigidity": f"{(found.rigidity - 1) * 100:+.2f} +- {errors['rigidity'][0] * 100:.2f} %",
        "gain": f"{each(found.gain, errors['gain'], 100.0, 1.0)} %",
        "position": f"{each(found.position_offset_mm, errors['position'])} mm",
        "curve": f"{found.curve_per_mm:+.4f} +- {errors['curve'][0]:.4f} per mm",
        "offset": f"{each(found.offset_mm, errors['offset'], 1e3)} um",
    }
    if "fixity" in errors:
        ends = zip(found.fixity, errors["fixity"], strict=True)
        left, right = (f"{value:.3f} +- {error:.3f}" for value, error in ends)
        shown["fixity"] = f"left {left}, right {right}"
    return shown


def run(model: ModelFile, options: argparse.Namespace) -> None:
    """Calibrate, write the model, and print the departures and the misfits before and after."""
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
        found = self_calibrate(model, contacts, progress)
    write_atomically(options.output, found.content)
    fresh = loading.load(options.output)
    fields = {"model": fresh.identity, "output": str(options.output), **_results(found, contacts)}
    show(Result(fields, [_rows(found, contacts, fresh.identity, model)]), as_json=options.json)


def _results(found: SelfCalibrated, contacts: UnlabelledContacts) -> dict[str, object]:
    metadata, fit = found.metadata, found.found
    calibration = metadata.calibration
    return {
        "calibration": None if calibration is None else calibration.model_dump(),
        "standard_errors": {kind: values.tolist() for kind, values in _standard_errors(found).items() if kind in KINDS},
        "misfit": {
            "before": fit.held_out.before,
            "after": fit.held_out.after,
            "expected": fit.held_out.expected,
        },
        "changed_mm": fit.left_open.shift_mm(),
        "open_mm": _rms(fit.left_open.position_mm),
        "single_contacts": float(fit.fit.single.sum()),
        "contacts_left_out": contacts.other_characteristic + contacts.older,
        "floor": metadata.floor.model_dump(),
        "accuracy": {**metadata.accuracy.model_dump(), "ratio": metadata.accuracy.ratio},
    }


def _rows(
    found: SelfCalibrated, contacts: UnlabelledContacts, identity: str, given: ModelFile
) -> list[tuple[str, str]]:
    metadata, fit, left_open = found.metadata, found.found, found.found.left_open
    departures = fit.fit.theory.departures(fit.fit.vector)
    shown = departures_in_words(metadata, departures, _standard_errors(found))
    held, force = fit.held_out, found.metadata.calibration.force_error if found.metadata.calibration else 0.0
    not_single = len(contacts) - fit.fit.single.sum()
    before, after = (_percent(one.floor.gain) for one in (given.metadata, metadata))
    return [
        ("model", identity),
        ("contacts", f"{len(contacts)}, of which about {not_single:.0f} are not single contacts"),
        *((kind, shown[kind]) for kind in KINDS),
        (
            "misfit",
            f"{digits(held.before, 3)} before, {digits(held.after, 3)} after, each by a fit without the contact "
            f"(medians; {digits(held.expected, 3)} from noise alone)",
        ),
        (
            "position",
            f"changes by {digits(left_open.shift_mm(), 3)} mm (root mean square), "
            f"{digits(_rms(left_open.position_mm), 3)} mm left open",
        ),
        *([("force", f"its scale stays open by {digits(100 * force, 2)} %")] if force else []),
        ("floor", f"gains +- {before} before, +- {after} now"),
    ]


def _standard_errors(found: SelfCalibrated) -> dict[str, Floats]:
    """Return the standard errors by kind; those of gains without the common scale, which is the force's."""
    fit = found.found.fit
    spread = np.sqrt(np.diag(found.found.left_open.relative))
    return fit.theory.standard_errors(fit.vector, spread)


def _percent(values: list[float]) -> str:
    """Return relative errors as one number, or as their range."""
    low, high = (digits(100 * end(values), 2) for end in (min, max))
    return f"{low} %" if low == high else f"{low}..{high} %"


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))
