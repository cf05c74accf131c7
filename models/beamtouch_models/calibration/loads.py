"""Recorded loads, from a file that `beamtouch-daemon record` wrote, averaged per load, and errors of a recording."""

import csv
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.metadata import Metadata

PSEUDO_LOADS = 0.25
"""Weight of the stated errors, in loads; they matter where the loads tell little."""
UPDATES = 10
"""Number of improvements of the errors in each round of a fit. A round starts from the errors of the previous one."""


@dataclass(frozen=True)
class RecordingErrors:
    """Standard deviations."""

    placing_mm: float
    """Of a load's position about the stated one."""
    force: float
    """Of the force of a load, relative to the stated one."""
    residual_mm: float = 0.0
    """Of each deflection, beyond its noise."""

    def at_least(self, other: "RecordingErrors") -> "RecordingErrors":
        """Return the larger of each pair."""
        return RecordingErrors(*np.maximum(astuple(self), astuple(other)).tolist())


@dataclass(frozen=True)
class Deflections:
    """The causes that move measured deflections away from their prediction."""

    is_measured: Bools
    """(loads, channels), whether there is a measurement."""
    noise_mm: Floats
    """(loads, channels)"""
    moved_mm: Floats
    """(2, loads, channels) by 1 mm of a load's position, and by its whole force."""

    def covariance_mm2(self, errors: RecordingErrors) -> Floats:
        """Return the covariance (loads, channels, channels); a channel without a measurement has variance 1."""
        variance = np.where(self.is_measured, self.noise_mm**2 + errors.residual_mm**2, 1.0)
        own = variance[..., None] * np.eye(self._channels)
        moved = self.moved_mm * np.array([errors.placing_mm, errors.force])[:, None, None]
        covariance: Floats = own + np.einsum("klc,kld->lcd", moved, moved)
        return covariance

    def whitening(self, errors: RecordingErrors) -> Floats:
        """Return W (loads, channels, channels), with W'W the inverse of the covariance."""
        return np.linalg.inv(np.linalg.cholesky(self.covariance_mm2(errors)))

    def errors_of(
        self, left_mm: Floats, about: RecordingErrors, start: RecordingErrors, freedom: float
    ) -> RecordingErrors:
        """Return the likely errors behind residuals (loads, channels) with `freedom` degrees of freedom.

        They maximise the likelihood (Zhou, Hu, Qiao & Lange 2019, doi 10.1080/10618600.2018.1529601), where `about`
        counts as much as `PSEUDO_LOADS` loads.
        """
        share = freedom / self.is_measured.sum()
        moved, left = np.moveaxis(self.moved_mm, 0, 2), left_mm[..., None]
        prior = np.array([about.placing_mm, about.force]) ** 2
        variance = np.array(astuple(start)) ** 2
        variance[2] = max(variance[2], float((self.noise_mm[self.is_measured] ** 2).mean()))
        for _ in range(UPDATES):
            inverse = np.linalg.inv(self.covariance_mm2(RecordingErrors(*np.sqrt(variance).tolist())))
            pulled = inverse @ left
            pulls = ((moved.transpose(0, 2, 1) @ pulled) ** 2).sum(axis=(0, 2))
            traces = share * (moved * (inverse @ moved)).sum(axis=(0, 1))
            safe = np.maximum(variance[:2], np.finfo(np.float64).tiny)
            pulls, traces = pulls + PSEUDO_LOADS * prior / safe**2, traces + PSEUDO_LOADS / safe
            own = share * np.trace(inverse * self.is_measured[..., None], axis1=1, axis2=2).sum()
            variance[:2] *= np.sqrt(pulls / traces)
            variance[2] *= np.sqrt((pulled**2).sum() / own)
        return RecordingErrors(*np.sqrt(variance).tolist())

    @property
    def _channels(self) -> int:
        return int(self.is_measured.shape[1])


MIN_POSITIONS = 4
MIN_SPREAD = 0.4
"""Smallest spread of the positions, over the range of positions: of known loads, or of the middle 80 % of contacts."""
MIN_SAMPLES = 5
MAX_DEFLECTIONS = 100.0
"""Largest sample, over the largest deflection of the model; a larger one cannot be in mm."""
FORCE_FACTOR = 1000.0
"""Factor by which a force may lie below or above the range of forces; beyond, it cannot be in N."""
GOOD = "good"
STATED = RecordingErrors(placing_mm=1.0, force=0.01)
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
    errors: RecordingErrors = STATED
    """Stated errors of the positions and forces of the loads."""

    def without(self, index: int) -> "Loads":
        """Return all loads but one."""
        kept = np.arange(len(self.number)) != index
        return self[kept]

    def __getitem__(self, kept: Bools) -> "Loads":
        arrays = ("number", "position_mm", "force_n", "measured_mm", "deviation_mm", "lines")
        return replace(self, **{name: getattr(self, name)[kept] for name in arrays})


def read_loads(path: Path, metadata: Metadata, leave_out: Sequence[int] = ()) -> Loads:
    """Read and average a recording, leaving out some loads by number; raises LoadsError with the reason."""
    channels = [channel.name for channel in metadata.layout]
    rows, _ = read_rows(path, LoadsError)
    if not rows:
        message = f"{path}: no samples; record loads with beamtouch-daemon record"
        raise LoadsError(message)
    wanted = ["load", "position_mm", "force_n", *(f"{name}_deflection_mm" for name in channels)]
    missing = [column for column in wanted if column not in rows[0]]
    if missing:
        message = f"{path}: column {missing[0]} is missing; record with the config of this model's surface"
        raise LoadsError(message)
    try:
        loads = _averaged(rows, channels, metadata)
    except LoadsError as error:
        message = f"{path}: {error}"
        raise LoadsError(message) from None
    except (ValueError, TypeError):
        message = f"{path}: a value is not a number; record again"
        raise LoadsError(message) from None
    for number in leave_out:
        if number not in loads.number:
            message = f"{path}: no load {number} to leave out; the loads are {', '.join(map(str, loads.number))}"
            raise LoadsError(message)
    loads = loads[~np.isin(loads.number, leave_out)]
    _check(path, loads, metadata)
    return loads


def read_rows(path: Path, refuse: type[InputError]) -> tuple[list[dict[str, str]], Sequence[str]]:
    """Return the rows and the columns of a CSV file; raises `refuse` if it is none."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            return list(reader), reader.fieldnames or []
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        message = f"{path}: {error.strerror if isinstance(error, OSError) else 'not a CSV file'}"
        raise refuse(message) from None


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
        message = (
            f"{channels[channel]} states {measured[line, channel]:g} mm in line {line + 2}, but this surface deflects "
            f"by {digits(metadata.max_deflection_mm, 3)} mm at most; check the unit and the daemon's config"
        )
        raise LoadsError(message)
    loads = np.unique(number)
    first = np.array([np.flatnonzero(number == load)[0] for load in loads])
    good = np.array([np.isfinite(measured[number == load]).sum(axis=0) for load in loads])
    sums = np.array([np.nansum(measured[number == load], axis=0) for load in loads])
    mean = np.where(good >= MIN_SAMPLES, sums / np.maximum(good, 1), np.nan)
    # Samples of a moving average share readings, so their mean is only as good as that of as many readings.
    deviation = metadata.noise.reading_mm / np.sqrt(np.maximum(good, 1))
    last = np.array([np.flatnonzero(number == load)[-1] for load in loads])
    for name, values in (("position_mm", position), ("force_n", force)):
        for load, start in zip(loads, first, strict=True):
            differs = np.flatnonzero((number == load) & (values != values[start]) & ~np.isnan(values[start]))
            if len(differs):
                message = (
                    f"load {load} has a {name} of {values[start]:g} in line {start + 2} and of "
                    f"{values[differs[0]]:g} in line {differs[0] + 2}; give each load a number of its own"
                )
                raise LoadsError(message)
    return Loads(loads, position[first], force[first], mean, deviation, np.stack([first, last], axis=1) + 2)


def _check(path: Path, loads: Loads, metadata: Metadata) -> None:
    """Raise LoadsError if no fit could use the loads."""
    low, high = metadata.ranges.position_mm
    weakest, strongest = metadata.ranges.force_n
    each = zip(loads.number, loads.lines, loads.position_mm, loads.force_n, strict=True)
    for number, (start, end), position, force in each:
        if not low <= position <= high:
            message = f"{path}: load {number} at {position:g} mm is not within {low:g}..{high:g} mm"
            raise LoadsError(message)
        if force <= 0 or not weakest / FORCE_FACTOR <= force <= strongest * FORCE_FACTOR:
            message = (
                f"{path}: load {number} (lines {start} to {end}) has a force of {force:g} N, but the model is for "
                f"{weakest:g}..{strongest:g} N; correct it, or use --leave-out {number}"
            )
            raise LoadsError(message)
    positions = np.unique(loads.position_mm)
    spread = float(np.ptp(positions)) / (high - low) if len(positions) else 0.0
    if len(positions) < MIN_POSITIONS or spread < MIN_SPREAD:
        message = (
            f"{path}: {len(positions)} different positions over {spread:.0%} of the range cannot determine a fit; "
            f"record at least {MIN_POSITIONS}, preferably 10, spread over the whole beam"
        )
        raise LoadsError(message)
    for number, (start, end), measured in zip(loads.number, loads.lines, loads.measured_mm, strict=True):
        if np.isnan(measured).all():
            message = (
                f"{path}: load {number} (lines {start} to {end}) has fewer than {MIN_SAMPLES} good samples of each "
                f"channel; record it again, or use --leave-out {number}"
            )
            raise LoadsError(message)
    silent = np.isnan(loads.measured_mm).all(axis=0)
    if silent.any():
        message = f"{path}: {metadata.layout[int(silent.argmax())].name} has no good samples; check it and record again"
        raise LoadsError(message)
