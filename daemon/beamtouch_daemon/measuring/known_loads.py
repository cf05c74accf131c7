"""Known loads, and the CSV file of their samples that `design-sensors calibrate` reads."""

import csv
import io
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from beamtouch_common.digits import MAX_DECIMALS
from beamtouch_common.encodings import decode
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import require_writable
from beamtouch_common.outline import BEAM_AXES, BEAM_AXIS
from beamtouch_common.units import MM
from beamtouch_daemon.config.settings import Loads, Surface
from beamtouch_daemon.measuring.figures import counts_text, rounded
from beamtouch_daemon.processing.pipeline import TimedSample

DIGITS = 9
"""Significant digits of a deflection that is not in mm."""
CHANNEL_COLUMNS = ("counts", "deflection_{unit}", "quality")


@dataclass(frozen=True)
class Load:
    """A known load, as the user states it."""

    place_mm: tuple[float, ...]
    """One number an axis."""
    force_n: float
    is_accepted: bool = field(default=False, compare=False)
    """True if it is recorded without checks."""

    def __str__(self) -> str:
        return f"{self.force_n:g} N at {', '.join(f'{at_mm:g}' for at_mm in self.place_mm)} mm"


def parse_load(words: Sequence[str], surface: Surface, *, is_accepted: bool) -> Load:
    """Return the load with a place and a force; ValueError with one line if it cannot be, or is outside the limits."""
    axes, limits = surface.axes, surface.loads
    try:
        *place_mm, force_n = (float(word.replace(",", ".")) for word in words)
        if len(place_mm) != len(axes):
            raise ValueError
    except ValueError:
        message = "give two numbers: the position in mm from the left end, and the force in N, as in 150 10"
        if axes != BEAM_AXES:
            message = "give three numbers: x and y in mm from the corner, and the force in N, as in 150 80 10"
        raise ValueError(message) from None
    message = _find_off(dict(zip(axes, place_mm, strict=True)), None if is_accepted else limits)
    if message:
        pass
    elif not 0 < force_n < math.inf:
        message = f"a force of {force_n:g} N is no load; give newtons (1 kg weighs 9.81 N)"
    elif limits and not is_accepted and force_n > limits.max_force_n:
        message = f"{force_n:g} N is more than {limits.max_force_n:g} N, the largest force that the model covers"
    if message:
        raise ValueError(message)
    return Load(tuple(place_mm), force_n, is_accepted)


def _find_off(place_mm: dict[str, float], limits: Loads | None) -> str:
    """Return why a place is not on the structure, or not within the limits; empty if it is."""
    for axis, at_mm in place_mm.items():
        is_beam = axis == BEAM_AXIS
        if not 0 <= at_mm < math.inf:
            if is_beam:
                return f"a position of {at_mm:g} mm is not on the beam; count from its left end"
            return f"{axis} = {at_mm:g} mm is not on the plate; count from its lower left corner"
        low_mm, high_mm = limits.ranges_mm[axis] if limits else (0.0, math.inf)
        if not low_mm <= at_mm <= high_mm:
            what = f"{at_mm:g} mm" if is_beam else f"{axis} = {at_mm:g} mm"
            return f"{what} is not within {low_mm:g} to {high_mm:g} mm, the range that the model covers"
    return ""


class LoadFile:
    """A file with a row per sample; it contains each load completely or not at all. Without a load there is no file.

    Parameters
    ----------
    path : The file.
    surface : Its axes, channels and unit are those of the file.
    append : Whether to add to an existing file.

    Raises
    ------
    InputError
        The file exists and `append` is false, or it is not a recording of these channels, or it cannot be written.
    """

    def __init__(self, path: Path, surface: Surface, *, append: bool) -> None:
        self.path = path
        self.loads = 0
        """Number of the last load in the file; 0 if there is none."""
        self._recorded: list[tuple[int, Load]] = []
        """Position in the file, and load, of each load that was added."""
        self._unit = surface.value_unit
        columns = [column.format(unit=self._unit) for column in CHANNEL_COLUMNS]
        self._header = [
            *("unix_time_s", "load", *(f"{axis}_mm" for axis in surface.axes), "force_n"),
            *(f"{name}_{column}" for name in surface.channel_names for column in columns),
        ]
        if path.exists() and not append:
            raise InputError(f"{path}: already exists; add --append or name another file")
        require_writable([path])
        if path.exists():
            self.loads = _last_load(path, self._header)

    def write(self, load: Load, samples: Sequence[TimedSample]) -> None:
        """Add a load, and begin the file with the first one; FailedError if that is impossible."""
        number = self.loads + 1
        rows: list[Sequence[object]] = [_row(number, load, taken, self._unit) for taken in samples]
        size = self.path.stat().st_size if self.path.exists() else 0
        try:
            with self.path.open("a", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows(rows if size else [self._header, *rows])
        except BaseException as error:  # also Ctrl-C
            self._cut(size)
            if isinstance(error, OSError):
                raise FailedError(f"{self.path}: {error.strerror}; {self}") from None
            raise
        self._recorded.append((size, load))
        self.loads = number

    def remove_last(self) -> Load | None:
        """Remove the load that was added last and return it; None if there is none."""
        if not self._recorded:
            return None
        size, load = self._recorded.pop()
        self._cut(size)
        self.loads -= 1
        return load

    def __str__(self) -> str:
        """Return what is in the file."""
        return f"{self.loads} loads are in {self.path}" if self.loads else "no load is recorded"

    def _cut(self, size: int) -> None:
        """Cut the file to its first bytes; without any, remove it."""
        with suppress(OSError):  # a disk that fails
            os.truncate(self.path, size) if size else self.path.unlink()


def _last_load(path: Path, header: Sequence[str]) -> int:
    """Return the number of the last load in a file; InputError if it is not a recording with these columns."""
    try:
        text = decode(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {error.strerror if isinstance(error, OSError) else error}") from None
    message = f"{path}: not a recording; write to another file"
    with suppress(ValueError, csv.Error):
        rows = list(csv.reader(io.StringIO(text)))
        if rows[:1] != [header]:
            message = f"{path}: its columns are not those of this surface; write to another file"
        elif text.endswith("\n") and {len(row) for row in rows} == {len(header)}:
            return max((int(row[1]) for row in rows[1:]), default=0)
    raise InputError(message)


def _row(number: int, load: Load, taken: TimedSample, unit: str) -> list[object]:
    sample = taken.sample
    cells: list[object] = [f"{sample.acquired_unix_us / 1e6:.6f}", number, *load.place_mm, load.force_n]
    for count, value, quality in zip(taken.reading.counts, sample.deflection_mm, sample.quality, strict=True):
        deflection = "" if value is None else _deflection_text(value, unit)
        cells += ["" if count is None else counts_text(count), deflection, quality.value]
    return cells


def _deflection_text(value: float, unit: str) -> str:
    """Return a deflection: to a nanometre if it is in mm, to digits that no sensor has in another unit."""
    return f"{rounded(value, MAX_DECIMALS):.{MAX_DECIMALS}f}" if unit == MM else f"{value:.{DIGITS}g}"
