"""Unlabelled contacts: mean deflections per event, from a file that the service offers. Place and force are unknown."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.calibration.loads import MAX_DEFLECTIONS, read_rows
from beamtouch_models.health.zeros import DRIFT
from beamtouch_models.metadata import Metadata

MAX_CONTACTS = 2000
"""Largest number of contacts that are used, the newest; it bounds the time of a fit."""
SURELY = 4.0
"""Deviations of each rest that may be noise."""
MIN_DEVIATION = 1e-6
"""Smallest deviation of a mean, over the largest deflection of the model: no sensor is so steady, and rounding would
hide it beside the errors of a contact."""
MAX_BYTES = 64 << 20
"""Largest file; a row takes about 200 bytes."""


class ContactsError(InputError):
    """A file of contacts cannot be read or belongs to another surface."""


@dataclass(frozen=True)
class UnlabelledContacts:
    """Contacts of unknown place and force."""

    measured_mm: Floats
    """(contacts, channels) mean deflection."""
    deviation_mm: Floats
    """(contacts, channels) standard deviation of that mean."""
    other_characteristic: int = 0
    """Number of rows that were left out because they have an older characteristic."""
    older: int = 0
    """Number of rows that were left out because there are more than `MAX_CONTACTS` newer ones."""
    rest_mm: Floats | None = None
    """(contacts, 2, channels) mean deflection of the rest before each contact and its deviation, NaN where it was not
    seen; None without any."""

    def __len__(self) -> int:
        return len(self.measured_mm)

    def noise_mm(self, zero_mm: Floats, left_error: float) -> Floats:
        """Return the standard deviation (contacts, channels) with zeros and a relative error of the deflections."""
        deviation: Floats = np.sqrt(self.deviation_mm**2 + zero_mm**2 + (left_error * self.measured_mm) ** 2)
        return deviation

    def moved_zeros(self, zero_mm: Floats) -> Indices:
        """Return the channels whose rests surely differ by more than `DRIFT` times the drift `zero_mm` (channels,).

        The fit takes a zero to be the same in all contacts.
        """
        if self.rest_mm is None:
            return np.empty(0, np.intp)
        rest, deviation = self.rest_mm[~np.isnan(self.rest_mm).any(axis=(1, 2))].transpose(1, 0, 2)
        highest = (rest - SURELY * deviation).max(axis=0, initial=-np.inf)
        lowest = (rest + SURELY * deviation).min(axis=0, initial=np.inf)
        return np.flatnonzero(highest - lowest > DRIFT * zero_mm)


@dataclass(frozen=True)
class _Row:
    """A row of the file, checked."""

    event: tuple[str, str]
    time: datetime
    characteristic: str
    measured_mm: list[float]
    deviation_mm: list[float]
    rest_mm: list[list[float]]
    """Mean and deviation; NaN where it was not seen."""


def read_contacts(path: Path, metadata: Metadata) -> UnlabelledContacts:
    """Read the contacts of a model's surface; raises ContactsError with the reason.

    Rows of the newest characteristic count, and an event counts once.
    """
    channels = [channel.name for channel in metadata.layout]
    if path.is_file() and path.stat().st_size > MAX_BYTES:
        raise ContactsError(f"{path}: it is larger than {MAX_BYTES >> 20} MiB; fetch fewer contacts, with ?limit=")
    given, names = read_rows(path, ContactsError)
    _check_columns(path, names, channels)
    if not given:
        raise ContactsError(f"{path}: no contacts; fetch them with GET /surfaces/NAME/calibration-data")
    rows = {}
    for line, row in enumerate(given, start=2):
        try:
            checked = _checked(row, channels, metadata)
        except ContactsError as error:
            raise ContactsError(f"{path}: line {line}: {error}") from None
        rows[checked.event] = checked
    return _newest(sorted(rows.values(), key=lambda row: row.time))


def _check_columns(path: Path, names: Sequence[str], channels: list[str]) -> None:
    wanted = ["event", "time", "model", "characteristic"]
    wanted += [f"{name}_{end}" for end in ("mm", "sd_mm") for name in channels]
    missing = [column for column in wanted if column not in names]
    if missing:
        raise ContactsError(f"{path}: column {missing[0]} is missing; fetch the contacts of this model's surface")
    others = [name.removesuffix("_sd_mm") for name in names if name.endswith("_sd_mm")]
    # A column such as s1_rest_sd_mm says more of a known channel.
    foreign = [name for name in others if not f"{name}_".startswith(tuple(f"{channel}_" for channel in channels))]
    if foreign:
        raise ContactsError(
            f"{path}: it has a channel {foreign[0]}, which this model has not; fetch the contacts of its surface"
        )


def _checked(row: dict[str, str], channels: list[str], metadata: Metadata) -> _Row:
    """Return a row as numbers; raises ContactsError with the reason."""
    surface = (row["model"] or "").rpartition("@")[0]
    if surface != metadata.name:
        raise ContactsError(f"it is of the model {row['model']}, but this model's name is {metadata.name}")
    try:
        time = datetime.fromisoformat(row["time"] or "")
        measured, deviation = ([float(row[f"{name}_{end}"]) for name in channels] for end in ("mm", "sd_mm"))
        rest = [[float(row.get(f"{name}_{end}") or "nan") for name in channels] for end in ("rest_mm", "rest_sd_mm")]
    except (ValueError, TypeError):
        raise ContactsError("a value is missing, or not a number or a time") from None
    if time.tzinfo is None:
        raise ContactsError(f"the time {row['time']} has no zone; it must end in Z")
    for name, value, error in zip(channels, measured, deviation, strict=True):
        if not (np.isfinite(value) and 0 < error < np.inf):
            raise ContactsError(f"{name} must have a finite deflection and a positive finite deviation")
        if max(abs(value), error) > MAX_DEFLECTIONS * metadata.max_deflection_mm:
            raise ContactsError(
                f"{name} states {value:g} +- {error:g} mm, but this surface deflects by "
                f"{digits(metadata.max_deflection_mm, 3)} mm at most; check the unit and the daemon's config"
            )
    if np.nanmax(np.abs(rest), initial=0.0) > MAX_DEFLECTIONS * metadata.max_deflection_mm:
        raise ContactsError("the rest before it is larger than any deflection; check the unit and the daemon's config")
    deviation = [max(error, MIN_DEVIATION * metadata.max_deflection_mm) for error in deviation]
    return _Row((row["event"] or "", row["time"]), time, row["characteristic"] or "", measured, deviation, rest)


def _newest(rows: list[_Row]) -> UnlabelledContacts:
    """Return the rows with the characteristic of the newest, at most MAX_CONTACTS."""
    same = [row for row in rows if row.characteristic == rows[-1].characteristic]
    used = same[-MAX_CONTACTS:]
    names = ("measured_mm", "deviation_mm", "rest_mm")
    measured, deviation, rest = (np.array([getattr(row, name) for row in used]) for name in names)
    return UnlabelledContacts(measured, deviation, len(rows) - len(same), len(same) - len(used), rest)
