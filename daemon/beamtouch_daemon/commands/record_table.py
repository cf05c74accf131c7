"""The CSV file of recorded loads."""

import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from beamtouch_common.errors import InputError
from beamtouch_common.files import require_writable
from beamtouch_daemon.commands.resolution import MAX_DECIMALS, counts_text, rounded
from beamtouch_daemon.processing.pipeline import Taken

LOAD_COLUMNS = ("unix_time_s", "load", "position_mm", "force_n")
CHANNEL_COLUMNS = ("counts", "deflection_mm", "quality")


@dataclass(frozen=True)
class Load:
    """A known load, as the user states it."""

    position_mm: float
    force_n: float
    is_accepted: bool = False
    """Whether it is recorded without checks."""

    def __str__(self) -> str:
        return f"{self.force_n:g} N at {self.position_mm:g} mm"


class Table:
    """A file with a row per sample; it contains each load completely or not at all."""

    def __init__(self, file: TextIO, channels: Sequence[str]) -> None:
        self._file = file
        self._channels = channels
        self._begun: list[tuple[int, int, Load]] = []
        """Position in the file, number and load of each recorded load."""
        self.loads = 0
        """Number of the last load in the file; 0 if there is none."""

    def header(self) -> list[str]:
        """Return the column names."""
        return [*LOAD_COLUMNS, *(f"{name}_{column}" for name in self._channels for column in CHANNEL_COLUMNS)]

    def write_header(self) -> None:
        """Write the first line of the file."""
        self._write([self.header()])

    def read(self) -> bool:
        """Read an existing file; return False if it has other columns. ValueError if it is not a recording."""
        if next(csv.reader([self._file.readline()]), []) != self.header():
            return False
        while line := self._read_line():
            start, row = line[0], next(csv.reader([line[1]]))
            if len(row) != len(self.header()) or not line[1].endswith("\n"):
                message = "a row is incomplete"
                raise ValueError(message)
            if (number := int(row[1])) > self.loads:
                self._begun.append((start, number, Load(float(row[2]), float(row[3]))))
                self.loads = number
        return True

    def write(self, load: Load, samples: Sequence[Taken]) -> None:
        """Add a load."""
        self._file.seek(0, io.SEEK_END)
        start = self._file.tell()
        self._write([self._row(load, taken) for taken in samples])
        self.loads += 1
        self._begun.append((start, self.loads, load))

    def remove_last(self) -> Load | None:
        """Remove the last load and return it; None if there is none."""
        if not self._begun:
            return None
        start, _, load = self._begun.pop()
        self._file.seek(start)
        self._file.truncate()
        self.loads = self._begun[-1][1] if self._begun else 0
        return load

    def _read_line(self) -> tuple[int, str] | None:
        """Return the position of the next line, and the line; None at the end."""
        start = self._file.tell()
        line = self._file.readline()
        return (start, line) if line else None

    def _row(self, load: Load, taken: Taken) -> list[object]:
        sample = taken.sample
        cells: list[object] = [f"{sample.acquired_unix_us / 1e6:.6f}", self.loads + 1, load.position_mm, load.force_n]
        for count, value, quality in zip(taken.reading.counts, sample.deflection_mm, sample.quality, strict=True):
            deflection = "" if value is None else f"{rounded(value, MAX_DECIMALS):.{MAX_DECIMALS}f}"
            cells += ["" if count is None else counts_text(count), deflection, quality.value]
        return cells

    def _write(self, rows: Sequence[Sequence[object]]) -> None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(rows)
        self._file.write(text.getvalue())
        self._file.flush()


@contextmanager
def table(path: Path, channels: Sequence[str], *, append: bool) -> Iterator[Table]:
    """Open a CSV file to record to.

    Raises
    ------
    InputError
        The file exists and `append` is false, or it has other columns, or it cannot be written.
    """
    try:
        if not path.is_file():
            require_writable([path])
        with path.open("r+" if append and path.exists() else "x", newline="", encoding="utf-8") as file:
            made = Table(file, channels)
            if file.mode == "x":
                made.write_header()
            else:
                _read(made, path)
            yield made
    except FileExistsError:
        message = f"{path}: already exists; add --append or name another file"
        raise InputError(message) from None
    except OSError as error:
        message = f"{path}: {error.strerror}"
        raise InputError(message) from None


def _read(made: Table, path: Path) -> None:
    try:
        fits = made.read()
    except ValueError:  # also bytes that are no text
        message = f"{path}: not a recording; write to another file"
        raise InputError(message) from None
    if not fits:
        message = f"{path}: its columns are not those of this surface; write to another file"
        raise InputError(message)
