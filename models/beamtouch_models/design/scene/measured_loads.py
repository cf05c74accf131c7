"""The table of a measured structure: known loads, and what each sensor shows under them or per newton of them.

A table of loads has the columns `position_mm`, `force_n` and a `NAME_deflection_mm` for each sensor, as
`beamtouch-daemon record` writes them: rows with the same number in the column `load` are samples of one load. A table
of influence has `position_mm` and a `NAME_mm_per_n` for each sensor.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_common.names import NAME
from beamtouch_models.arrays import Floats
from beamtouch_models.design.rows import RecordingError, Row, parse_rows

OF_LOADS, PER_NEWTON = "_deflection_mm", "_mm_per_n"
"""Ends of the columns of sensors in a table of loads, and in one of influence."""
BESIDE = ("unix_time_s", "load", "_counts", "_quality")
"""Columns that `record` writes as well, or their ends."""
FEWEST, MOST = 4, 500
"""Loads of a table: with fewer nothing tells how smooth the influence is, with more a fit takes long."""
PLACES = 3
"""Fewest different places."""
LARGEST = 1e9
"""Largest number of a table, in mm, N or mm/N; a larger one is no measurement."""
DIGITS = 9
"""Significant digits of a table in a model file."""


@dataclass(frozen=True, eq=False)
class MeasuredLoads:
    """Known loads on a structure, and what its sensors show."""

    names: tuple[str, ...]
    """Of the sensors, in the order of the columns."""
    position_mm: Floats
    """(loads,)"""
    force_n: Floats
    """(loads,), 1 in a table of influence."""
    deflection_mm: Floats
    """(loads, sensors) mean of the samples of each load."""
    is_per_newton: bool
    """True if the table is one of influence: forces are not known then."""

    @property
    def influence_mm_per_n(self) -> Floats:
        """(loads, sensors) deflection over force."""
        per_newton: Floats = self.deflection_mm / self.force_n[:, None]
        return per_newton

    def to_csv(self) -> str:
        """Return the table as CSV text with a row for each load."""
        if self.is_per_newton:
            columns, known = [f"{name}{PER_NEWTON}" for name in self.names], [self.position_mm]
        else:
            columns = ["force_n", *(f"{name}{OF_LOADS}" for name in self.names)]
            known = [self.position_mm, self.force_n]
        rows = np.column_stack([*known, self.deflection_mm])
        lines = [",".join(["position_mm", *columns]), *(",".join(f"{x:.{DIGITS}g}" for x in row) for row in rows)]
        return "\n".join(lines) + "\n"


def parse_loads(text: str, origin: str) -> MeasuredLoads:
    """Read the table of a measured structure from CSV text; RecordingError in one line, which begins with `origin`."""
    rows, columns = parse_rows(text, origin)
    try:
        return _loads_of(rows, [column.strip() for column in columns])
    except RecordingError as error:
        raise RecordingError(f"{origin}: {error}") from None


def _loads_of(rows: list[Row], columns: Sequence[str]) -> MeasuredLoads:
    end = PER_NEWTON if any(column.endswith(PER_NEWTON) for column in columns) else OF_LOADS
    names = _names_in(columns, end)
    if not rows:
        raise RecordingError("it has no loads, only the names of columns; add a row for each load")
    per_newton = end == PER_NEWTON
    known = np.array(
        [[_number_in(row, "position_mm"), 1.0 if per_newton else _number_in(row, "force_n")] for row in rows]
    )
    for row, (position, force) in zip(rows, known, strict=True):
        if position < 0:
            raise RecordingError(f"line {row.number}: position_mm is {position:g}; count places from the left end")
        if force <= 0:
            what = "is no load; take the row out" if force == 0 else "pulls; state forces that press as positive"
            raise RecordingError(f"line {row.number}: force_n = {force:g} {what}")
    shown = np.array([[_shown_in(row, f"{name}{end}", f"{name}_quality") for name in names] for row in rows])
    numbers = [row.load() if row.cells.get("load") else -index for index, row in enumerate(rows, start=1)]
    loads = list(dict.fromkeys(numbers))
    groups = [np.flatnonzero(np.array(numbers) == load) for load in loads]
    for load, own in zip(loads, groups, strict=True):
        if np.ptp(known[own], axis=0).any():
            first, last = rows[own[0]].number, rows[own[-1]].number
            raise RecordingError(
                f"load {load} is at two places or has two forces in lines {first} to {last}; number it anew"
            )
    good = np.array([np.isfinite(shown[own]).sum(axis=0) for own in groups])
    if not good.all():
        load, sensor = np.argwhere(good == 0)[0]
        line = rows[groups[load][0]].number
        raise RecordingError(f"line {line}: {names[sensor]} has no good sample of this load; take the load out")
    mean = np.array([np.nansum(shown[own], axis=0) for own in groups]) / good
    places = known[[own[0] for own in groups]]
    _check(places[:, 0], mean, names)
    return MeasuredLoads(names, places[:, 0], places[:, 1], mean, per_newton)


def _names_in(columns: Sequence[str], end: str) -> tuple[str, ...]:
    """Return the names of the sensors; RecordingError if a column is missing or unknown."""
    names = tuple(column.removesuffix(end) for column in columns if column.endswith(end))
    wanted = ["position_mm"] if end == PER_NEWTON else ["position_mm", "force_n"]
    told = (
        f"the columns of loads are position_mm, force_n and NAME{OF_LOADS}, those of influence position_mm and "
        f"NAME{PER_NEWTON}"
    )
    if missing := [column for column in wanted if column not in columns]:
        raise RecordingError(f"column {missing[0]} is missing; {told}")
    if not names:
        raise RecordingError(f"it has no column of a sensor; {told}")
    known = (*wanted, *BESIDE[:2], *(f"{name}{also}" for name in names for also in (end, *BESIDE[2:])))
    if unknown := [column for column in columns if column not in known]:
        raise RecordingError(f"column {unknown[0]!r} is not known; {told}")
    if wrong := [name for name in names if not re.fullmatch(NAME, name)]:
        raise RecordingError(f"column {wrong[0]}{end} does not begin with the name of a sensor, as s1{end} does")
    return names


def _number_in(row: Row, column: str) -> float:
    """Return a finite number of a row; RecordingError if there is none."""
    value = row.number_in(column)
    if not abs(value) <= LARGEST:
        raise RecordingError(f"line {row.number}: {column} is {value:g}, which nobody measures; correct it")
    return value


def _shown_in(row: Row, column: str, quality: str) -> float:
    """Return what a sensor shows in a row; NaN where `record` says that it was not good."""
    return _number_in(row, column) if row.cells.get(quality, "good") == "good" else np.nan


def _check(position_mm: Floats, deflection_mm: Floats, names: Sequence[str]) -> None:
    """Raise RecordingError if the loads cannot determine an influence."""
    if not FEWEST <= len(position_mm) <= MOST:
        few = len(position_mm) < FEWEST
        told = (
            f"fewer than {FEWEST}; measure some 20, over the whole range of contacts"
            if few
            else f"more than {MOST}; leave some out"
        )
        raise RecordingError(f"{len(position_mm)} loads are {told}")
    if (places := len(np.unique(position_mm))) < PLACES:
        raise RecordingError(
            f"all loads are at {places} of at least {PLACES} places; spread them over the range of contacts"
        )
    if silent := [name for name, shown in zip(names, deflection_mm.T, strict=True) if not shown.any()]:
        raise RecordingError(f"{silent[0]} is 0 under all loads; check the sensor, or take its column out")
