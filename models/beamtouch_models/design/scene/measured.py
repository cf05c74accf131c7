"""The measured structure of a scene: anything elastic whose influence was measured, in place of a beam."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field, ValidationInfo, field_validator, model_validator

from beamtouch_common.encodings import decode
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.design.scene.beam import DIGITS, text_of
from beamtouch_models.design.scene.tables import Finite, Place, PositiveFinite, Strict

if TYPE_CHECKING:  # no help waits for numpy
    from beamtouch_models import places
    from beamtouch_models.design.scene.measured_loads import MeasuredLoads

FOLDER = "folder"
"""Key of the validation's context: the folder that the path of a table is relative to."""
MAX_BYTES = 64 << 20
"""Largest table; a row takes about 200 bytes."""
NUDGE = 0.01
"""Distance of two sensors that read most at the same place, over the length."""


class Measured(Strict):
    """A structure whose influence was measured: what its sensors show under known loads."""

    influence: str
    """Path of a CSV file, relative to the scene, or its text. Of loads: `position_mm` (or `x_mm` and `y_mm`), `force_n`
    and `NAME_deflection_mm` for each sensor, as `beamtouch-daemon record` writes them. Of influence: the places and
    `NAME_mm_per_n`. Sensors that do not show mm have their unit there, as in `NAME_deflection_uV/V` and
    `NAME_uV/V_per_n`: all that the scene states in `_mm` on what sensors show is in this unit, and `_um` in a
    thousandth of it."""
    theory: str | None = None
    """Path of a table of influence by theory, `position_mm` and `NAME_mm_per_n` for each sensor, or its text. It need
    be right up to a factor for each sensor only, which is fitted to the loads, as is by how much the theory misses
    them. Few loads are enough then: 4 to 12, at three places or more."""
    length_mm: PositiveFinite | None = None
    """Length of a structure of one axis. Default: up to the last load or sensor."""
    length_x_mm: PositiveFinite | None = None
    """On a structure of two axes: its length along the first one."""
    length_y_mm: PositiveFinite | None = None
    """On a structure of two axes: its length along the second one."""
    sensors_mm: dict[str, Finite | Place] = Field(default_factory=dict)
    """Positions of the sensors, by name: { s1 = 120, s2 = 280 }; on two axes { s1 = { x_mm = 20, y_mm = 30 } }. Pages
    draw them there. Default: where each shows most."""

    curved: bool = False
    """True if what the sensors show is no straight function of the deflection: a characteristic that rises with the
    force is then fitted for each from the same loads, which need two forces or more at some places. `build` writes it
    into the daemon's configuration."""

    @field_validator("influence", "theory")
    @classmethod
    def _whole(cls, value: str | None, info: ValidationInfo) -> str | None:
        """Return the text of the table, in few columns, so that a model holds all of it."""
        if value is None:
            return None
        if "\n" in value:
            return _read(value, "the theory" if info.field_name == "theory" else "the table").to_csv()
        path = Path((info.context or {}).get(FOLDER, ".")) / value
        return _read(_content_of(path), value).to_csv()

    @model_validator(mode="after")
    def _sensors_are_known(self) -> Measured:
        names = self.loads.names
        if unknown := [name for name in self.sensors_mm if name not in names]:
            raise ValueError(f"sensors_mm names {unknown[0]}, but the table has {', '.join(names)}")
        if self.sensors_mm and (missing := [name for name in names if name not in self.sensors_mm]):
            raise ValueError(f"sensors_mm lacks {missing[0]}; state all, or none")
        if self.curved and self.loads.is_per_newton:
            raise ValueError("curved needs a table of loads, as one of influence has no forces; or leave it out")
        if self.theory is not None:
            self._check_theory(_read(self.theory, "the theory"))
        self._check_places()
        return self

    def _check_theory(self, theory: MeasuredLoads) -> None:
        """Raise ValueError unless a theory is of the sensors and of the places of the table, on one axis."""
        if self.axes > 1 or theory.axes > 1:
            raise ValueError("theory is for structures of one axis; leave it out, and measure more loads")
        if not theory.is_per_newton:
            raise ValueError(
                "theory has forces; it is a table of influence, with the columns position_mm, NAME_mm_per_n"
            )
        if missing := [name for name in self.loads.names if name not in theory.names]:
            raise ValueError(
                f"theory has no column {missing[0]}_mm_per_n; add it, or take {missing[0]} out of the loads"
            )
        low, high = float(theory.place_mm.min()), float(theory.place_mm.max())
        if beyond := [place for place in self.loads.place_mm[:, 0].tolist() if not low <= place <= high]:
            raise ValueError(
                f"theory goes from {low:g} to {high:g} mm, but the table has a load at {beyond[0]:g} mm; "
                "compute it there, too"
            )

    def _check_places(self) -> None:
        """Raise ValueError if places have other axes than the table, coincide, or are not on the structure."""
        axes, places = self.axes, self._stated_places
        others = ("length_x_mm", "length_y_mm") if axes == 1 else ("length_mm",)
        if wrong := [key for key in others if getattr(self, key) is not None]:
            right = "length_mm" if axes == 1 else "length_x_mm and length_y_mm"
            raise ValueError(f"{wrong[0]} is not of the axes of the table; state {right}")
        if wrong := [name for name, place in places.items() if len(place) != axes]:
            written = "120" if axes == 1 else "{ x_mm = 20, y_mm = 30 }"
            raise ValueError(f"sensors_mm: {wrong[0]} has not the axes of the table; write {wrong[0]} = {written}")
        for name, place in places.items():
            if twice := [other for other, taken in places.items() if other != name and taken == place]:
                beside = "; of one chip, state them a little apart" if axes > 1 else ""
                raise ValueError(
                    f"sensors_mm has {in_words(place)} mm twice; two sensors, {name} and {twice[0]}, cannot share a "
                    f"position{beside}"
                )
            if min(place) < 0:
                origin = "left end" if axes == 1 else "lower left corner"
                raise ValueError(f"sensors_mm: {name} stands at {in_words(place)} mm; count from the {origin}")
        loads = [tuple(place) for place in self.loads.place_mm.tolist()]
        for axis, (key, length_mm) in enumerate(self._stated_lengths.items()):
            if length_mm is not None:
                beyond = [f"the load at {in_words(place)} mm" for place in loads if place[axis] > length_mm]
                beyond += [f"{name} at {in_words(at)} mm" for name, at in places.items() if at[axis] > length_mm]
                if beyond:
                    raise ValueError(f"{key} = {length_mm:g}, but {beyond[0]} is beyond it; correct one of them")

    @property
    def loads(self) -> MeasuredLoads:
        """The loads of the table."""
        return _read(self.influence, "the table")

    @property
    def axes(self) -> int:
        """Number of axes."""
        return self.loads.axes

    @property
    def size_mm(self) -> tuple[float, ...]:
        """Length along each axis, as stated or up to the last load or sensor."""
        reached = self.loads.place_mm.max(axis=0).tolist()
        return tuple(
            max([reached[axis], *(place[axis] for place in self._stated_places.values())])
            if length_mm is None
            else length_mm
            for axis, length_mm in enumerate(self._stated_lengths.values())
        )

    @property
    def places_mm(self) -> dict[str, places.Place]:
        """Places of the sensors, by name: as stated, or where each shows most."""
        by_name = self._stated_places or _where_most(self.loads, self.size_mm)
        return {name: place if self.axes > 1 else place[0] for name, place in by_name.items()}

    @property
    def _stated_places(self) -> dict[str, tuple[float, ...]]:
        return {
            name: (place.x_mm, place.y_mm) if isinstance(place, Place) else (place,)
            for name, place in self.sensors_mm.items()
        }

    @property
    def _stated_lengths(self) -> dict[str, float | None]:
        if self.axes == 1:
            return {"length_mm": self.length_mm}
        return {"length_x_mm": self.length_x_mm, "length_y_mm": self.length_y_mm}


def in_words(place: Sequence[float]) -> str:
    """Return a place in words, without its unit: `120`, or `(120, 80)` on two axes."""
    numbers = ", ".join(f"{number:g}" for number in place)
    return numbers if len(place) == 1 else f"({numbers})"


def _content_of(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"{path}: larger than {MAX_BYTES >> 20} MiB; is it the right file?")
        return decode(path.read_bytes())
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}; give the path of a CSV file, relative to the scene") from None


@lru_cache(maxsize=16)
def _read(text: str, origin: str) -> MeasuredLoads:
    from beamtouch_models.design.scene.measured_loads import parse_loads  # noqa: PLC0415  # no help waits for numpy

    try:
        return parse_loads(text, origin)
    except RecordingError as error:
        raise ValueError(str(error)) from None


def _where_most(loads: MeasuredLoads, size_mm: tuple[float, ...]) -> dict[str, tuple[float, ...]]:
    """Return the place at which each sensor shows most; where these are the same, beside each other along one axis."""
    length_mm = size_mm[0]
    step_mm = NUDGE * length_mm
    places: dict[str, tuple[float, ...]] = {}
    for name, shown in zip(loads.names, loads.influence_mm_per_n.T, strict=True):
        along, *across = loads.place_mm[abs(shown).argmax()].tolist()
        side = step_mm if along <= length_mm / 2 else -step_mm
        while any(math.dist((along, *across), taken) < step_mm / 2 for taken in places.values()):
            along += side
        places[name] = (min(max(along, 0.0), length_mm), *across)
    return places


def identity_of_measured(
    measured: Measured, sensors_mm: Mapping[str, tuple[float, ...]], error_mm: Sequence[float | None]
) -> str:
    """Return the identity of a measured structure with some of its sensors: of its table, and of where they stand.

    `error_mm`, noise and drift of zeros of a sensor, decides how smooth the characteristic of a curved one is, and how
    a theory is fitted.
    """
    places = {name: ", ".join(map(text_of, place)) for name, place in sensors_mm.items()}
    facts = {"influence": measured.influence, "sensors_mm": places, "curved": measured.curved}
    facts["length_mm"] = ", ".join(map(text_of, measured.size_mm))
    facts["error_mm"] = [text_of(mm) for mm in error_mm] if measured.curved or measured.theory else []
    if measured.theory is not None:
        facts["theory"] = measured.theory
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:DIGITS]
