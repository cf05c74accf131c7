"""The table of a measured structure: known loads, and what each sensor shows under them or per newton of them.

A table of loads has the columns `position_mm` (or `x_mm` and `y_mm`), `force_n` and a `NAME_deflection_mm` for each
sensor, as `beamtouch-daemon record` writes them: rows with the same number in the column `load` are samples of one
load. A table of influence has the places and a `NAME_mm_per_n` for each sensor. What is not measured in mm has its unit
there: `NAME_deflection_uV/V`, `NAME_uV/V_per_n`.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from beamtouch_common.names import NAME
from beamtouch_common.outline import BEAM_AXES, PLATE_AXES
from beamtouch_common.units import LENGTHS_MM, MM, UNIT, plain
from beamtouch_models.arrays import Floats
from beamtouch_models.design.rows import RecordingError, Row, parse_rows

OF_LOADS, PER_NEWTON = re.compile(rf"(.*)_deflection_({UNIT})"), re.compile(rf"(.*)_({UNIT})_per_n")
"""Columns of sensors in a table of loads, and in one of influence: name and unit."""
BESIDE = ("_counts", "_quality")
"""Ends of the columns that `record` writes for each sensor as well."""
FEWEST, MOST = 4, 10_000
"""Loads of a table: with fewer nothing tells how smooth the influence is, more are a mistake."""
PLACES, MOST_PLACES = 3, 1500
"""Different places along each axis at least, and of all loads at most: the time of a fit grows with their cube."""
NARROW = 0.01
"""Places of two axes that spread less than this across a line, over their spread along it, stand on that line."""
LARGEST = 1e9
"""Largest number of a table, in mm, N or mm/N; a larger one is no measurement."""
DIGITS = 9
"""Significant digits of a table in a model file."""


@dataclass(frozen=True, eq=False)
class MeasuredLoads:
    """Known loads on a structure, and what its sensors show."""

    names: tuple[str, ...]
    """Of the sensors, in the order of the columns."""
    place_mm: Floats
    """(loads, axes)"""
    force_n: Floats
    """(loads,), 1 in a table of influence."""
    deflection_mm: Floats
    """(loads, sensors) mean of the samples of each load."""
    is_per_newton: bool
    """True if the table is one of influence: forces are not known then."""
    unit: str = MM
    """Unit of the deflections; where it is another one than mm, figures in `_mm` are in it."""

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.place_mm.T)

    @property
    def influence_mm_per_n(self) -> Floats:
        """(loads, sensors) deflection over force."""
        per_newton: Floats = self.deflection_mm / self.force_n[:, None]
        return per_newton

    def to_csv(self) -> str:
        """Return the table as CSV text with a row for each load."""
        columns, known = list(place_columns(self.axes)), [self.place_mm]
        if self.is_per_newton:
            columns += [f"{name}_{self.unit}_per_n" for name in self.names]
        else:
            columns += ["force_n", *(column_of(name, self.unit) for name in self.names)]
            known.append(self.force_n[:, None])
        rows = np.column_stack([*known, self.deflection_mm])
        lines = [",".join(columns), *(",".join(f"{x:.{DIGITS}g}" for x in row) for row in rows.tolist())]
        return "\n".join(lines) + "\n"


def place_columns(axes: int) -> tuple[str, ...]:
    """Return the columns of places on one axis or two."""
    return tuple(f"{axis}_mm" for axis in (BEAM_AXES if axes == 1 else PLATE_AXES))


def column_of(name: str, unit: str) -> str:
    """Return the column of what a sensor shows under loads."""
    return f"{name}_deflection_{unit}"


def parse_loads(text: str, origin: str) -> MeasuredLoads:
    """Read the table of a measured structure from CSV text; RecordingError in one line, which begins with `origin`."""
    rows, columns = parse_rows(text, origin)
    try:
        return _loads_of(rows, columns)
    except RecordingError as error:
        raise RecordingError(f"{origin}: {error}") from None


def _loads_of(rows: list[Row], columns: Sequence[str]) -> MeasuredLoads:
    per_newton = any(map(PER_NEWTON.fullmatch, columns))
    sensors = _sensors_in(columns, per_newton=per_newton)
    names = tuple(name for name, _ in sensors.values())
    if not rows:
        raise RecordingError("it has no loads, only the names of columns; add a row for each load")
    places = [column for column in _place_columns_in(columns) if column in columns]
    known = np.array([[_number_in(row, column) for column in places] for row in rows])
    force_n = np.array([1.0 if per_newton else _number_in(row, "force_n") for row in rows])
    for row, place_mm, force in zip(rows, known.tolist(), force_n.tolist(), strict=True):
        if below := [f"{column} is {mm:g}" for column, mm in zip(places, place_mm, strict=True) if mm < 0]:
            origin = "left end" if len(places) == 1 else "lower left corner"
            raise RecordingError(f"line {row.number}: {below[0]}; count places from the {origin}")
        if force <= 0:
            what = "is no load; take the row out" if force == 0 else "pulls; state forces that press as positive"
            raise RecordingError(f"line {row.number}: force_n = {force:g} {what}")
    shown = np.array(
        [[_shown_in(row, column, f"{name}_quality") for column, (name, _) in sensors.items()] for row in rows]
    )
    groups = rows_of_loads(rows)
    first = np.array([own[0] for own in groups.values()])
    for load, own in groups.items():
        if np.ptp(known[own], axis=0).any() or np.ptp(force_n[own]) > 0:
            begin, end = rows[own[0]].number, rows[own[-1]].number
            raise RecordingError(
                f"load {load} is at two places or has two forces in lines {begin} to {end}; number it anew"
            )
    good = np.array([np.isfinite(shown[own]).sum(axis=0) for own in groups.values()])
    if not good.all():
        load, sensor = np.argwhere(good == 0)[0]
        line = rows[first[load]].number
        raise RecordingError(f"line {line}: {names[sensor]} has no good sample of this load; take the load out")
    mean = np.array([np.nansum(shown[own], axis=0) for own in groups.values()]) / good
    _check(known[first], mean, names)
    return MeasuredLoads(names, known[first], force_n[first], mean, per_newton, next(iter(sensors.values()))[1])


def rows_of_loads(rows: Sequence[Row]) -> dict[int, list[int]]:
    """Return the rows of each load by its number; those without one are loads of their own, with negative numbers."""
    groups: dict[int, list[int]] = {}
    for index, row in enumerate(rows):
        groups.setdefault(row.load() if row.cells.get("load") else -1 - index, []).append(index)
    return groups


def _place_columns_in(columns: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of places that a table has, or should have; RecordingError if it has those of both."""
    (along,) = place_columns(1)
    of_plane = [column for axis in PLATE_AXES for unit in (MM, *LENGTHS_MM) if (column := f"{axis}_{unit}") in columns]
    if of_plane and along in columns:
        raise RecordingError(f"it has both {along} and {of_plane[0]}; state places along one axis, or along x and y")
    return place_columns(2 if of_plane else 1)


def _sensors_in(columns: Sequence[str], *, per_newton: bool) -> dict[str, tuple[str, str]]:
    """Return name and unit of the sensor in each column that has one; RecordingError if a column is missing or wrong.

    Further columns are the user's own, unless their names say that they are forces or deflections, too.
    """
    of_sensor = PER_NEWTON if per_newton else OF_LOADS
    matches = {column: of_sensor.fullmatch(column) for column in columns}
    found = {column: (match[1], plain(match[2])) for column, match in matches.items() if match}
    places = _place_columns_in(columns)
    wanted = [*places] if per_newton else [*places, "force_n"]
    of_places = "position_mm (or x_mm and y_mm)" if len(places) == 1 else "x_mm, y_mm"
    told = (
        f"the columns of loads are {of_places}, force_n and NAME_deflection_mm, those of influence "
        f"{of_places.replace(', ', ' and ')} and NAME_mm_per_n; another unit takes the place of mm in them, as in "
        "NAME_deflection_uV/V"
    )
    if missing := [column for column in wanted if column not in columns]:
        raise RecordingError(f"column {missing[0]} is missing; {_hint_at(missing[0], columns)}{told}")
    if lengths := [column for column, (_, unit) in found.items() if unit in LENGTHS_MM]:
        _, unit = found[lengths[0]]
        raise RecordingError(
            f"column {lengths[0]}: lengths are in mm; convert it, one {unit} is {LENGTHS_MM[unit]:g} mm, and name it so"
        )
    if not found:
        raise RecordingError(f"it has no column of a sensor; {told}")
    names = [name for name, _ in found.values()]
    known = {*wanted, "unix_time_s", "load", *found, *(f"{name}{end}" for name in names for end in BESIDE)}
    if unknown := [column for column in columns if column not in known and _seems_measured(column)]:
        raise RecordingError(f"column {unknown[0]!r} is not known; {told}")
    if wrong := [column for column, (name, _) in found.items() if not re.fullmatch(NAME, name)]:
        raise RecordingError(f"column {wrong[0]} does not begin with the name of a sensor, as s1_deflection_mm does")
    if twice := [name for number, name in enumerate(names) if name in names[:number]]:
        raise RecordingError(f"two columns are of {twice[0]}, in different units; take one out")
    units = {unit: name for name, unit in found.values()}
    if len(units) > 1:
        (first, name), (second, other) = list(units.items())[:2]
        raise RecordingError(
            f"{name} is in {first} and {other} in {second}; sensors of one structure are of one kind, with one unit"
        )
    return found


def _seems_measured(column: str) -> bool:
    """Return whether the name of a column that is not known says that it may be of a sensor, a place or a force."""
    return "deflection" in column or column.rpartition("_")[2] in (MM, *LENGTHS_MM, "n", "N", "kg", "g")


def _hint_at(missing: str, columns: Sequence[str]) -> str:
    """Return what to do about a column that seems to be the missing one in another unit; empty if there is none."""
    named, _, _ = missing.rpartition("_")
    other = next((column for column in columns if column.rpartition("_")[0] == named), None)
    if other is None:
        return ""
    remedy = "one g weighs 0.00981 N, one kg 9.81 N" if named == "force" else "one um is 0.001 mm, one m 1000 mm"
    return f"convert {other}: {remedy}; "


def _number_in(row: Row, column: str) -> float:
    """Return a finite number of a row; RecordingError if there is none."""
    value = row.number_in(column)
    if not abs(value) <= LARGEST:
        raise RecordingError(f"line {row.number}: {column} is {value:g}, which nobody measures; correct it")
    return value


def _shown_in(row: Row, column: str, quality: str) -> float:
    """Return what a sensor shows in a row; NaN where `record` says that it was not good."""
    return _number_in(row, column) if row.cells.get(quality, "good") == "good" else np.nan


def _check(place_mm: Floats, deflection_mm: Floats, names: Sequence[str]) -> None:
    """Raise RecordingError if the loads cannot determine an influence."""
    if not FEWEST <= len(place_mm) <= MOST:
        few = len(place_mm) < FEWEST
        told = (
            f"fewer than {FEWEST}; measure some 20, over the whole range of contacts"
            if few
            else f"more than {MOST}; leave some out"
        )
        raise RecordingError(f"{len(place_mm)} loads are {told}")
    if (different := len(np.unique(place_mm, axis=0))) > MOST_PLACES:
        raise RecordingError(f"loads are at {different} places, more than {MOST_PLACES}; leave some out")
    for column, along in zip(place_columns(place_mm.shape[1]), place_mm.T, strict=True):
        if (places := len(np.unique(along))) < PLACES:
            of_axis = "places" if place_mm.shape[1] == 1 else column
            raise RecordingError(
                f"all loads are at {places} of at least {PLACES} {of_axis}; spread them over the range of contacts"
            )
    spread = np.linalg.svd(place_mm - place_mm.mean(axis=0), compute_uv=False)
    if spread[-1] < NARROW * spread[0]:
        raise RecordingError("all loads are on one line; spread them over both axes of the range of contacts")
    if silent := [name for name, shown in zip(names, deflection_mm.T, strict=True) if not shown.any()]:
        raise RecordingError(f"{silent[0]} is 0 under all loads; check the sensor, or take its column out")
    for one, other in combinations(range(len(names)), 2):
        if np.array_equal(deflection_mm[:, one], deflection_mm[:, other]):
            raise RecordingError(
                f"{names[one]} and {names[other]} show the same under all loads, to the last digit; one is a copy: "
                "correct it, or take its column out"
            )
