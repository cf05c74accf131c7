"""The rows of CSV files that people and `beamtouch-daemon record` write, checked with messages of one line."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from beamtouch_common.encodings import decode
from beamtouch_common.errors import InputError
from beamtouch_common.units import plain


class RecordingError(InputError):
    """A recording cannot be read, belongs to another surface, or cannot determine a fit."""


@dataclass(frozen=True)
class Row:
    """A row of a CSV file, and its last line there, counted from 1."""

    number: int
    cells: dict[str, str]
    """By the names of their columns; empty if the row is too short."""

    def number_in(self, column: str) -> float:
        """Return the number in a column; raises RecordingError if there is none."""
        cell = self.cells[column]
        try:
            return float(cell)
        except ValueError:
            fault = f"states {cell!r}, which is not a number" if cell else "is empty"
            raise RecordingError(f"line {self.number}: {column} {fault}; write 12.5, without a unit") from None

    def load(self) -> int:
        """Return the number of the load; raises RecordingError if it is no whole number."""
        number = self.number_in("load")
        if not number.is_integer():
            raise RecordingError(f"line {self.number}: load is {number:g}; number the loads 1, 2, 3")
        return int(number)


def read_rows(path: Path) -> tuple[list[Row], Sequence[str]]:
    """Return the rows of a CSV file, without empty ones, and the columns; raises RecordingError if it is none."""
    try:
        text = decode(path.read_bytes())
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else f"not a CSV file: {error}"
        raise RecordingError(f"{path}: {reason}") from None
    return parse_rows(text, str(path))


def parse_rows(text: str, origin: str) -> tuple[list[Row], Sequence[str]]:
    """Return the rows and the columns of CSV text as `read_rows`; `origin` begins the messages."""
    try:
        reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
        columns = [plain(name.strip()) for name in next(reader, [])]
        given = [(reader.line_num, cells) for cells in reader if any(cells)]
    except csv.Error as error:
        raise RecordingError(f"{origin}: not a CSV file: {error}") from None
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(columns) == 1 and mark in columns[0]:
            remedy = "separate them by commas, and write decimals with a point"
            raise RecordingError(f"{origin}: {name} separate the columns; {remedy}")
    twice = [name for name in columns if name and columns.count(name) > 1]
    if twice:
        raise RecordingError(f"{origin}: two columns are named {twice[0]}; take one out")
    for number, cells in given:
        if len(columns) > 1 and any(cells[len(columns) :]):
            raise RecordingError(
                f"{origin}: line {number} has {len(cells)} values in {len(columns)} columns; write decimals with a "
                "point"
            )
    rows = [Row(number, dict(zip_longest(columns, cells[: len(columns)], fillvalue=""))) for number, cells in given]
    return rows, columns
