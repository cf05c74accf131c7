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
from beamtouch_models.commands.departures import departures_in_words
from beamtouch_models.commands.options import shown_progress
from beamtouch_models.commands.printing import Result, show
from beamtouch_models.health.zeros import DRIFT
from beamtouch_models.loading import ModelFile


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
