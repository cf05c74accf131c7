"""The measured structure of a scene: anything elastic whose influence was measured, in place of a beam."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field, ValidationInfo, field_validator, model_validator

from beamtouch_common.encodings import decode
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.design.scene.beam import DIGITS, text_of
from beamtouch_models.design.scene.tables import Finite, PositiveFinite, Strict

if TYPE_CHECKING:
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
    """Path of a CSV file, relative to the scene, or its text. Of loads: `position_mm`, `force_n` and
    `NAME_deflection_mm` for each sensor, as `beamtouch-daemon record` writes them. Of influence: `position_mm` and
    `NAME_mm_per_n`. Sensors that do not show mm have their unit there, as in `NAME_deflection_uV/V` and
    `NAME_uV/V_per_n`: all that the scene states in `_mm` on what sensors show is in this unit, and `_um` in a
    thousandth of it."""
    theory: str | None = None
    """Path of a table of influence by theory, `position_mm` and `NAME_mm_per_n` for each sensor, or its text. It need
    be right up to a factor for each sensor only, which is fitted to the loads, as is by how much the theory misses
    them. Few loads are enough then: 4 to 12, at three places or more."""
    length_mm: PositiveFinite | None = None
    """Length of the structure. Default: up to the last load or sensor."""
    sensors_mm: dict[str, Finite] = Field(default_factory=dict)
    """Positions of the sensors, by name: { s1 = 120, s2 = 280 }. Pages draw them there. Default: where each shows most.
    """

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
        places = list(self.sensors_mm.values())
        if twice := [place for place in places if places.count(place) > 1]:
            raise ValueError(f"sensors_mm has {twice[0]:g} mm twice; two sensors cannot share a position")
        if self.length_mm is not None:
            beyond = [f"the load at {place:g} mm" for place in self.loads.position_mm if place > self.length_mm]
            beyond += [f"{name} at {place:g} mm" for name, place in self.sensors_mm.items() if place > self.length_mm]
            if beyond:
                raise ValueError(f"length_mm = {self.length_mm:g}, but {beyond[0]} is beyond it; correct one of them")
        if below := [name for name, place in self.sensors_mm.items() if place < 0]:
            raise ValueError(
                f"sensors_mm: {below[0]} stands at {self.sensors_mm[below[0]]:g} mm; count from the left end"
            )
        return self

    def _check_theory(self, theory: MeasuredLoads) -> None:
        """Raise ValueError unless a theory is of the sensors and of the places of the table."""
        if not theory.is_per_newton:
            raise ValueError(
                "theory has forces; it is a table of influence, with the columns position_mm, NAME_mm_per_n"
            )
        if missing := [name for name in self.loads.names if name not in theory.names]:
            raise ValueError(
                f"theory has no column {missing[0]}_mm_per_n; add it, or take {missing[0]} out of the loads"
            )
        low, high = float(theory.position_mm.min()), float(theory.position_mm.max())
        if beyond := [place for place in self.loads.position_mm.tolist() if not low <= place <= high]:
            raise ValueError(
                f"theory goes from {low:g} to {high:g} mm, but the table has a load at {beyond[0]:g} mm; "
                "compute it there, too"
            )

    @property
    def loads(self) -> MeasuredLoads:
        """The loads of the table."""
        return _read(self.influence, "the table")

    @property
    def end_mm(self) -> float:
        """Length of the structure, as stated or up to the last load or sensor."""
        farthest = max(float(self.loads.position_mm.max()), *self.sensors_mm.values(), 0.0)
        return farthest if self.length_mm is None else self.length_mm

    @property
    def size_mm(self) -> tuple[float, ...]:
        """Length along each axis."""
        return (self.end_mm,)

    @property
    def places_mm(self) -> dict[str, float]:
        """Positions of the sensors, by name: as stated, or where each shows most."""
        return self.sensors_mm or _where_most(self.loads, self.end_mm)


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


def _where_most(loads: MeasuredLoads, length_mm: float) -> dict[str, float]:
    """Return the place at which each sensor shows most; beside each other where these are the same."""
    step_mm = NUDGE * length_mm
    places: dict[str, float] = {}
    for name, shown in zip(loads.names, loads.influence_mm_per_n.T, strict=True):
        there = float(loads.position_mm[abs(shown).argmax()])
        side = step_mm if there <= length_mm / 2 else -step_mm
        while any(abs(there - taken) < step_mm / 2 for taken in places.values()):
            there += side
        places[name] = min(max(there, 0.0), length_mm)
    return places


def identity_of_measured(measured: Measured, sensors_mm: Mapping[str, float], error_mm: Sequence[float | None]) -> str:
    """Return the identity of a measured structure with some of its sensors: of its table, and of where they stand.

    `error_mm`, noise and drift of zeros of a sensor, decides how smooth the characteristic of a curved one is, and how
    a theory is fitted.
    """
    places = {name: text_of(mm) for name, mm in sensors_mm.items()}
    facts = {"influence": measured.influence, "sensors_mm": places, "curved": measured.curved}
    facts["length_mm"] = text_of(measured.end_mm)
    facts["error_mm"] = [text_of(mm) for mm in error_mm] if measured.curved or measured.theory else []
    if measured.theory is not None:
        facts["theory"] = measured.theory
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:DIGITS]
