"""The files of a calibration: loads that `beamtouch-daemon record` wrote, averaged per load, and unlabelled contacts.

Unlabelled contacts are mean deflections per event, from a file that the service offers; place and force are unknown.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.rows import RecordingError, Row, read_rows
from beamtouch_models.design.scene.measured_loads import column_of
from beamtouch_models.places import Extent, in_words
from beamtouch_models.runtime.health.changes import DRIFT
from beamtouch_models.runtime.health.residuals import LoadErrors
from beamtouch_models.runtime.metadata import Metadata

MIN_POSITIONS = 4
MIN_SPREAD = 0.4
"""Smallest spread of the places over their range along each axis: of known loads, or of the middle 80 % of contacts."""
MIN_SAMPLES = 5
MAX_DEFLECTIONS = 100.0
"""Largest deflection, over the largest of the model; a larger one cannot be in mm."""
FORCE_FACTOR = 1000.0
"""Factor by which a force may lie below or above the range of forces; beyond, it cannot be in N."""
GOOD, TIME = "good", "unix_time_s"
MAX_MINUTES = 24 * 60.0
"""Longest recording; if it takes longer, the times of its loads say nothing of their zeros."""
STATED = LoadErrors(placing_mm=1.0, force=0.01)
"""Errors of loads that a person places by a ruler and weighs on a scale."""
EXCHANGED = "the columns x_mm and y_mm seem to be exchanged; check them"


@dataclass(frozen=True)
class Loads:
    """Known loads and the deflections that the sensors measured."""

    number: Indices
    """(loads,) numbers in the file."""
    place_mm: Floats
    """(loads, axes)"""
    force_n: Floats
    """(loads,)"""
    measured_mm: Floats
    """(loads, channels) mean deflection; NaN if a channel was not good."""
    deviation_mm: Floats
    """(loads, channels) standard deviation of that mean."""
    lines: Indices
    """(loads, 2) first and last line of each load in the file, counted from 1."""
    minutes: Floats
    """(loads,) time of each load since the first; 0 if the file has no times."""
    errors: LoadErrors = STATED
    """Stated errors of the places and forces of the loads."""

    def without(self, *indices: int) -> "Loads":
        """Return all loads but some."""
        return self[~np.isin(np.arange(len(self.number)), indices)]

    def __getitem__(self, kept: Bools | list[int]) -> "Loads":
        arrays = ("number", "place_mm", "force_n", "measured_mm", "deviation_mm", "lines", "minutes")
        return replace(self, **{name: getattr(self, name)[kept] for name in arrays})

    def in_words(self, index: int) -> str:
        """Return the number of a load, and where it is in its file."""
        first, last = self.lines[index]
        where = f"line {first}" if first == last else f"lines {first} to {last}"
        return f"load {self.number[index]} ({where})"


def read_loads(path: Path, metadata: Metadata, leave_out: Sequence[int] = ()) -> Loads:
    """Read and average a recording, leaving out some loads by number; raises RecordingError with the reason."""
    channels = [channel.name for channel in metadata.layout]
    rows, columns = read_rows(path)
    if not rows:
        raise RecordingError(f"{path}: no samples; record loads with beamtouch-daemon record")
    wanted = [
        "load",
        *(f"{axis}_mm" for axis in metadata.axes),
        "force_n",
        *(column_of(name, metadata.unit) for name in channels),
    ]
    missing = [column for column in wanted if column not in columns]
    if missing:
        raise RecordingError(
            f"{path}: column {missing[0]} is missing; this model needs the columns {', '.join(wanted)}"
        )
    try:
        loads = _averaged(rows, channels, metadata)
        for number in leave_out:
            if number not in loads.number:
                raise RecordingError(
                    f"no load {number} to leave out; the loads are {', '.join(map(str, loads.number))}"
                )
        loads = loads[~np.isin(loads.number, leave_out)]
        _check(loads, metadata)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    return loads


def _averaged(rows: list[Row], channels: list[str], metadata: Metadata) -> Loads:
    """Return the means of all loads; raises RecordingError if a value is not a number."""
    number, line = np.array([row.load() for row in rows]), np.array([row.number for row in rows])
    stated = {
        column: np.array([row.number_in(column) for row in rows])
        for column in (*(f"{axis}_mm" for axis in metadata.axes), "force_n")
    }
    measured = np.array([[_deflection_mm(row, name, metadata.unit) for name in channels] for row in rows])
    beyond = np.argwhere(np.abs(measured) > MAX_DEFLECTIONS * metadata.max_deflection_mm)
    if len(beyond):
        row, channel = beyond[0]
        raise RecordingError(
            f"{channels[channel]} states {measured[row, channel]:g} {metadata.unit} in line {line[row]}, "
            f"{_but_at_most(metadata)}"
        )
    loads = np.unique(number)
    rows_of_loads = [np.flatnonzero(number == load) for load in loads]
    for name, values in stated.items():
        for load, own in zip(loads, rows_of_loads, strict=True):
            said = values[own[0]]
            differs = own[(values[own] != said) & ~np.isnan(said)]
            if len(differs):
                raise RecordingError(
                    f"load {load} has a {name} of {said:g} in line {line[own[0]]} and of {values[differs[0]]:g} in "
                    f"line {line[differs[0]]}; give each load a number of its own"
                )
    good = np.array([np.isfinite(measured[own]).sum(axis=0) for own in rows_of_loads])
    sums = np.array([np.nansum(measured[own], axis=0) for own in rows_of_loads])
    mean = np.where(good >= MIN_SAMPLES, sums / np.maximum(good, 1), np.nan)
    # Samples of a moving average share readings, so their mean is only as good as that of as many readings.
    deviation = metadata.noise.reading_mm / np.sqrt(np.maximum(good, 1))
    ends = np.array([(own[0], own[-1]) for own in rows_of_loads])
    *coordinates, force = (values[ends[:, 0]] for values in stated.values())
    place, minutes = np.column_stack(coordinates), _minutes(rows, rows_of_loads)
    return Loads(loads, place, force, mean, deviation, line[ends], minutes)


def _but_at_most(metadata: Metadata) -> str:
    largest = digits(metadata.max_deflection_mm, 3)
    return f"but this surface deflects by {largest} {metadata.unit} at most; check the unit and the daemon's config"


def _minutes(rows: list[Row], each: list[Indices]) -> Floats:
    """Return the time of each load since the first [min]; 0 if some load has none."""
    try:
        seconds = np.array([float(row.cells.get(TIME, "")) for row in rows])
    except ValueError:
        return np.zeros(len(each))
    minutes = np.array([seconds[own].mean() for own in each]) / 60
    since: Floats = minutes - minutes.min()
    return since if np.isfinite(since).all() and since.max() < MAX_MINUTES else np.zeros(len(each))


def _deflection_mm(row: Row, channel: str, unit: str) -> float:
    """Return a channel's deflection; NaN if it has none, or is not good."""
    column, quality = column_of(channel, unit), row.cells.get(f"{channel}_quality", GOOD)
    return row.number_in(column) if row.cells[column] and quality == GOOD else np.nan


def may_be_exchanged(extent: Extent, place_mm: Floats) -> bool:
    """Return whether all places (loads, axes) are on the structure with their axes exchanged, and there are two."""
    other_mm = place_mm[:, ::-1]
    return extent.axes > 1 and bool(np.all((extent.low_mm <= other_mm) & (other_mm <= extent.high_mm)))


def _check(loads: Loads, metadata: Metadata) -> None:
    """Raise RecordingError if no fit could use the loads."""
    extent, (weakest, strongest) = metadata.extent, metadata.ranges.force_n
    short: Bools = np.all(np.isnan(loads.measured_mm), axis=1)
    if short.size and short.all():
        raise RecordingError(
            f"no load has {MIN_SAMPLES} good samples of a channel; each load needs {MIN_SAMPLES} rows or more"
        )
    for index, (place, force) in enumerate(zip(loads.place_mm, loads.force_n, strict=True)):
        number, load = loads.number[index], loads.in_words(index)
        if not np.all((extent.low_mm <= place) & (place <= extent.high_mm)):
            within = " by ".join(f"{low:g}..{high:g}" for low, high in extent.ranges_mm)
            hint = f"; {EXCHANGED}" if may_be_exchanged(extent, loads.place_mm) else ""
            raise RecordingError(f"load {number} at {in_words(place)} mm is not within {within} mm{hint}")
        if force <= 0 or not weakest / FORCE_FACTOR <= force <= strongest * FORCE_FACTOR:
            raise RecordingError(
                f"{load} has a force of {force:g} N, but the model is for {weakest:g}..{strongest:g} N; correct it, "
                f"or use --leave-out {number}"
            )
        if short[index]:
            raise RecordingError(
                f"{load} has fewer than {MIN_SAMPLES} good samples of each channel; record it again, or use "
                f"--leave-out {number}"
            )
    places = np.unique(loads.place_mm, axis=0)
    spread = float((np.ptp(places, axis=0) / extent.size_mm).min()) if len(places) else 0.0
    if len(places) < MIN_POSITIONS or spread < MIN_SPREAD:
        what, best, where = ("positions", 10, "beam") if extent.axes == 1 else ("places", 12, "plate")
        raise RecordingError(
            f"{len(places)} different {what} over {spread:.0%} of the range cannot determine a fit; record at "
            f"least {MIN_POSITIONS}, preferably {best}, spread over the whole {where}"
        )
    silent = np.isnan(loads.measured_mm).all(axis=0)
    if silent.any():
        name = metadata.layout[int(silent.argmax())].name
        raise RecordingError(f"{name} has no good samples; check it and record again")


MAX_CONTACTS = 2000
"""Largest number of contacts that are used, the newest; it bounds the time of a fit."""
SURELY = 4.0
"""Deviations of each rest that may be noise."""
MIN_DEVIATION = 1e-6
"""Smallest deviation of a mean, over the largest deflection of the model: no sensor is so steady, and rounding would
hide it beside the errors of a contact."""
MAX_BYTES = 64 << 20
"""Largest file; a row takes about 200 bytes."""


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
    """A row of a file of contacts, checked."""

    event: tuple[str, str]
    time: datetime
    characteristic: str
    values_mm: list[list[float]]
    """(4, channels) mean and deviation of the contact, and of the rest before it; NaN where that was not seen."""


def read_contacts(path: Path, metadata: Metadata) -> UnlabelledContacts:
    """Read the contacts of a model's surface; raises RecordingError with the reason.

    Rows of the newest characteristic count, and an event counts once.
    """
    channels = [channel.name for channel in metadata.layout]
    if path.is_file() and path.stat().st_size > MAX_BYTES:
        raise RecordingError(f"{path}: it is larger than {MAX_BYTES >> 20} MiB; fetch fewer contacts, with ?limit=")
    given, columns = read_rows(path)
    wanted = ["event", "time", "model", "characteristic"]
    wanted += [f"{name}_{end}" for end in ("mm", "sd_mm") for name in channels]
    missing = [column for column in wanted if column not in columns]
    if missing:
        raise RecordingError(f"{path}: column {missing[0]} is missing; fetch the contacts of this model's surface")
    others = [column.removesuffix("_sd_mm") for column in columns if column.endswith("_sd_mm")]
    # A column such as s1_rest_sd_mm says more of a known channel.
    foreign = [name for name in others if not f"{name}_".startswith(tuple(f"{channel}_" for channel in channels))]
    if foreign:
        remedy = "fetch the contacts of its surface"
        raise RecordingError(f"{path}: it has a channel {foreign[0]}, which this model has not; {remedy}")
    if not given:
        raise RecordingError(f"{path}: no contacts; fetch them with GET /surfaces/NAME/calibration-data")
    by_event = {}
    for line in given:
        try:
            checked = _checked(line.cells, channels, metadata)
        except RecordingError as error:
            raise RecordingError(f"{path}: line {line.number}: {error}") from None
        by_event[checked.event] = checked
    rows = sorted(by_event.values(), key=lambda row: row.time)
    same = [row for row in rows if row.characteristic == rows[-1].characteristic]
    values = np.array([row.values_mm for row in same[-MAX_CONTACTS:]])
    left_out = len(rows) - len(same), len(same) - len(values)
    return UnlabelledContacts(values[:, 0], values[:, 1], *left_out, rest_mm=values[:, 2:])


def _checked(row: dict[str, str], channels: list[str], metadata: Metadata) -> _Row:
    """Return a row as numbers; raises RecordingError with the reason."""
    if (row["model"] or "").rpartition("@")[0] != metadata.name:
        raise RecordingError(f"it is of the model {row['model']}, but this model's name is {metadata.name}")
    try:
        time = datetime.fromisoformat(row["time"] or "")
        measured, deviation = ([float(row[f"{name}_{end}"]) for name in channels] for end in ("mm", "sd_mm"))
        rest = [[float(row.get(f"{name}_{end}") or "nan") for name in channels] for end in ("rest_mm", "rest_sd_mm")]
    except (ValueError, TypeError):
        raise RecordingError("a value is missing, or not a number or a time") from None
    if time.tzinfo is None:
        raise RecordingError(f"the time {row['time']} has no zone; it must end in Z")
    for name, value, error in zip(channels, measured, deviation, strict=True):
        if not (np.isfinite(value) and 0 < error < np.inf):
            raise RecordingError(f"{name} must have a finite deflection and a positive finite deviation")
        if max(abs(value), error) > MAX_DEFLECTIONS * metadata.max_deflection_mm:
            raise RecordingError(f"{name} states {value:g} +- {error:g} {metadata.unit}, {_but_at_most(metadata)}")
    if np.nanmax(np.abs(rest), initial=0.0) > MAX_DEFLECTIONS * metadata.max_deflection_mm:
        raise RecordingError("the rest before it is larger than any deflection; check the unit and the daemon's config")
    deviation = [max(error, MIN_DEVIATION * metadata.max_deflection_mm) for error in deviation]
    return _Row((row["event"] or "", row["time"]), time, row["characteristic"] or "", [measured, deviation, *rest])
