"""Recorded loads, from a file that `beamtouch-daemon record` wrote, averaged per load."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.health.residuals import LoadErrors
from beamtouch_models.metadata import Metadata

MIN_POSITIONS = 4
MIN_SPREAD = 0.4
"""Smallest spread of the positions, over the range of positions: of known loads, or of the middle 80 % of contacts."""
MIN_SAMPLES = 5
MAX_DEFLECTIONS = 100.0
"""Largest sample, over the largest deflection of the model; a larger one cannot be in mm."""
FORCE_FACTOR = 1000.0
"""Factor by which a force may lie below or above the range of forces; beyond, it cannot be in N."""
GOOD = "good"
STATED = LoadErrors(placing_mm=1.0, force=0.01)
"""Errors of loads that a person places by a ruler and weighs on a scale."""


class LoadsError(InputError):
    """A recording cannot be read, belongs to another surface, or cannot determine a fit."""


@dataclass(frozen=True)
class Loads:
    """Known loads and the deflections that the sensors measured."""

    number: Indices
    """(loads,) numbers in the file."""
    position_mm: Floats
    force_n: Floats
    measured_mm: Floats
    """(loads, channels) mean deflection; NaN if a channel was not good."""
    deviation_mm: Floats
    """(loads, channels) standard deviation of that mean."""
    lines: Indices
    """(loads, 2) first and last line of each load in the file, counted from 1."""
    errors: LoadErrors = STATED
    """Stated errors of the positions and forces of the loads."""

    def without(self, *indices: int) -> "Loads":
        """Return all loads but some."""
        return self[~np.isin(np.arange(len(self.number)), indices)]

    def __getitem__(self, kept: Bools) -> "Loads":
        arrays = ("number", "position_mm", "force_n", "measured_mm", "deviation_mm", "lines")
        return replace(self, **{name: getattr(self, name)[kept] for name in arrays})


def read_loads(path: Path, metadata: Metadata, leave_out: Sequence[int] = ()) -> Loads:
    """Read and average a recording, leaving out some loads by number; raises LoadsError with the reason."""
    channels = [channel.name for channel in metadata.layout]
    rows, _ = read_rows(path, LoadsError)
    if not rows:
        raise LoadsError(f"{path}: no samples; record loads with beamtouch-daemon record")
    wanted = ["load", "position_mm", "force_n", *(f"{name}_deflection_mm" for name in channels)]
    missing = [column for column in wanted if column not in rows[0]]
    if missing:
        raise LoadsError(f"{path}: column {missing[0]} is missing; this model needs the columns {', '.join(wanted)}")
    try:
        loads = _averaged(rows, channels, metadata)
    except LoadsError as error:
        raise LoadsError(f"{path}: {error}") from None
    except (ValueError, TypeError):
        raise LoadsError(f"{path}: a value is not a number; record again") from None
    for number in leave_out:
        if number not in loads.number:
            raise LoadsError(
                f"{path}: no load {number} to leave out; the loads are {', '.join(map(str, loads.number))}"
            )
    loads = loads[~np.isin(loads.number, leave_out)]
    _check(path, loads, metadata)
    return loads


def read_rows(path: Path, refuse: type[InputError]) -> tuple[list[dict[str, str]], Sequence[str]]:
    """Return the rows and the columns of a CSV file; raises `refuse` if it is none."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            rows, columns = list(reader), reader.fieldnames or []
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise refuse(f"{path}: {error.strerror if isinstance(error, OSError) else 'not a CSV file'}") from None
    if len(columns) == 1 and (other := next((mark for mark in ";\t" if mark in columns[0]), "")):
        name = {";": "semicolons", "\t": "tabs"}[other]
        raise refuse(f"{path}: {name} separate the columns; separate them by commas, and write decimals with a point")
    return rows, columns


def lines(first_last: Indices) -> str:
    """Return where a load is in its file, in words."""
    first, last = first_last
    return f"line {first}" if first == last else f"lines {first} to {last}"


def _averaged(rows: list[dict[str, str]], channels: list[str], metadata: Metadata) -> Loads:
    number = np.array([int(row["load"]) for row in rows])
    position, force = (np.array([float(row[column]) for row in rows]) for column in ("position_mm", "force_n"))
    measured = np.array(
        [
            [
                float(row[f"{name}_deflection_mm"] or "nan") if row.get(f"{name}_quality", GOOD) == GOOD else np.nan
                for name in channels
            ]
            for row in rows
        ]
    )
    beyond = np.argwhere(np.abs(measured) > MAX_DEFLECTIONS * metadata.max_deflection_mm)
    if len(beyond):
        line, channel = beyond[0]
        raise LoadsError(
            f"{channels[channel]} states {measured[line, channel]:g} mm in line {line + 2}, but this surface deflects "
            f"by {digits(metadata.max_deflection_mm, 3)} mm at most; check the unit and the daemon's config"
        )
    loads = np.unique(number)
    each = [np.flatnonzero(number == load) for load in loads]
    for name, values in (("position_mm", position), ("force_n", force)):
        for load, own in zip(loads, each, strict=True):
            said = values[own[0]]
            differs = own[(values[own] != said) & ~np.isnan(said)]
            if len(differs):
                raise LoadsError(
                    f"load {load} has a {name} of {said:g} in line {own[0] + 2} and of {values[differs[0]]:g} in line "
                    f"{differs[0] + 2}; give each load a number of its own"
                )
    good = np.array([np.isfinite(measured[own]).sum(axis=0) for own in each])
    sums = np.array([np.nansum(measured[own], axis=0) for own in each])
    mean = np.where(good >= MIN_SAMPLES, sums / np.maximum(good, 1), np.nan)
    # Samples of a moving average share readings, so their mean is only as good as that of as many readings.
    deviation = metadata.noise.reading_mm / np.sqrt(np.maximum(good, 1))
    ends = np.array([(own[0], own[-1]) for own in each])
    return Loads(loads, position[ends[:, 0]], force[ends[:, 0]], mean, deviation, ends + 2)


def _check(path: Path, loads: Loads, metadata: Metadata) -> None:
    """Raise LoadsError if no fit could use the loads."""
    low, high = metadata.ranges.position_mm
    weakest, strongest = metadata.ranges.force_n
    short = np.isnan(loads.measured_mm).all(axis=1)
    if short.size and short.all():
        raise LoadsError(
            f"{path}: no load has {MIN_SAMPLES} good samples of a channel; each load needs {MIN_SAMPLES} rows or more"
        )
    for number, where, position, force, measured in zip(
        loads.number, loads.lines, loads.position_mm, loads.force_n, loads.measured_mm, strict=True
    ):
        if not low <= position <= high:
            raise LoadsError(f"{path}: load {number} at {position:g} mm is not within {low:g}..{high:g} mm")
        if force <= 0 or not weakest / FORCE_FACTOR <= force <= strongest * FORCE_FACTOR:
            raise LoadsError(
                f"{path}: load {number} ({lines(where)}) has a force of {force:g} N, but the model is for "
                f"{weakest:g}..{strongest:g} N; correct it, or use --leave-out {number}"
            )
        if np.isnan(measured).all():
            raise LoadsError(
                f"{path}: load {number} ({lines(where)}) has fewer than {MIN_SAMPLES} good samples of each "
                f"channel; record it again, or use --leave-out {number}"
            )
    positions = np.unique(loads.position_mm)
    spread = float(np.ptp(positions)) / (high - low) if len(positions) else 0.0
    if len(positions) < MIN_POSITIONS or spread < MIN_SPREAD:
        raise LoadsError(
            f"{path}: {len(positions)} different positions over {spread:.0%} of the range cannot determine a fit; "
            f"record at least {MIN_POSITIONS}, preferably 10, spread over the whole beam"
        )
    silent = np.isnan(loads.measured_mm).all(axis=0)
    if silent.any():
        name = metadata.layout[int(silent.argmax())].name
        raise LoadsError(f"{path}: {name} has no good samples; check it and record again")
