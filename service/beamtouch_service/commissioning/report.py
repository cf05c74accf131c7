"""The result of a commissioning: its figures, its verdict in words, and all of it as text. Pure."""

from enum import StrEnum

from pydantic import BaseModel, ConfigDict

from beamtouch_common.digits import digits
from beamtouch_common.table import aligned
from beamtouch_common.units import MM
from beamtouch_models.runtime import State
from beamtouch_service.samples import Quality


class Finding(StrEnum):
    """Findings of the presses on a sensor."""

    RIGHT = "right"
    """Its channel moves as it should."""
    DEAD = "dead"
    """Its channel does not move."""
    INVERTED = "inverted"
    """Its channel moves the wrong way."""
    SWAPPED = "swapped"
    """Its channel shows what another sensor should."""
    GAIN = "gain"
    """Its channel moves too little or too much, next to the others."""
    UNSURE = "unsure"
    """Several wirings explain the presses about as well, or none does."""
    UNSEEN = "unseen"
    """The press above it was not seen."""


class _Part(BaseModel):
    model_config = ConfigDict(use_attribute_docstrings=True)


PlaceMm = dict[str, float]
"""Axis -> a figure along it [mm]."""


class SensorResult(_Part):
    """A sensor, and the press above it."""

    name: str
    at_mm: PlaceMm
    """The place to press, by axis: the sensor's own, or the nearest one at which the model knows contacts."""
    finding: Finding | None = None
    """Null until it has been pressed."""
    says: str = ""
    """The finding in words."""
    share: float | None = None
    """Movement of its channel in all presses over what the model says of the sensor that it shows, relative to the
    other channels; null if that is too little to see."""
    quality: Quality | None = None
    """Quality of its channel during the press above it."""
    moved_mm: dict[str, float | None] | None = None
    """Movement of each channel during the press above it, from rest, null for one that mostly had no values; null if
    the press was not seen."""
    force_n: float | None = None
    """Force of the press, as the model explains the movements."""


class PlaceResult(_Part):
    """A marked place, and what the surface said of the press there."""

    at_mm: PlaceMm
    """The place to press, by axis."""
    state: State | None = None
    """State of the surface during the press; null without one."""
    stated_mm: dict[str, tuple[float, float, float]] | None = None
    """Axis -> the stated coordinate and the ends of its interval; null without a contact."""
    force_n: float | None = None
    error_mm: PlaceMm | None = None
    """Axis -> stated coordinate less that of the mark."""
    allowed_mm: PlaceMm | None = None
    """Axis -> largest error that passes: how exactly a person presses, and the half-width of the interval."""
    says: str = ""
    """The result in words; empty until it has been pressed."""


class Report(_Part):
    """The result of a commissioning, or what there is of it so far."""

    surface: str
    model: str
    """Name and fingerprint of the model."""
    beam: str
    """Identity of the beam and layout that the model is of."""
    begun_at: str
    """Time by the clock of the service (RFC 3339)."""
    ended_at: str | None = None
    """Time of its confirmation; null until then."""
    by: str = ""
    """Name of the person who confirmed it, as typed."""
    passed: bool | None = None
    """Null until every step is done."""
    verdict: list[str] = []
    """In sentences, with what to do; what is known so far until every step is done."""
    unit: str = MM
    """Unit of the movements of channels."""
    sensors: list[SensorResult]
    places: list[PlaceResult]


class Recorded(Report):
    """A result on record."""

    id: int


def as_text(report: Report) -> str:
    """Return a result as text for people."""
    passed = {True: "PASSED", False: "NOT PASSED", None: "not finished"}[report.passed]
    about = {
        "surface": report.surface,
        "model": report.model,
        "beam": report.beam,
        "begun": report.begun_at,
        "confirmed": f"{report.ended_at or 'not yet'}{f' by {report.by}' if report.by else ''}",
        "result": passed,
    }
    names = [sensor.name for sensor in report.sensors]
    moved = [
        [
            *(sensor.name, _place(sensor.at_mm)),
            *(_moved(sensor, name, report.unit) for name in names),
            *(_share(sensor), sensor.says),
        ]
        for sensor in report.sensors
    ]
    places = [
        [_place(one.at_mm), _place(_middles(one)), _interval(one), _place(one.error_mm), one.says]
        for one in report.places
    ]
    return "\n".join(
        [
            "Commissioning of a Beamtouch surface",
            "",
            *(f"{name:<10}{value}" for name, value in about.items()),
            "",
            *report.verdict,
            "",
            f"Presses above the sensors: movement of each channel in {report.unit}, from rest",
            *aligned(["above", "at mm", *names, "share", "finding"], moved, range(1, len(names) + 3)),
            "",
            "Presses at marked places",
            *aligned(["mark mm", "says mm", "95 % interval", "error mm", "result"], places, (0, 1, 3)),
            "",
        ]
    )


def _figure(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


def _moved(sensor: SensorResult, channel: str, unit: str) -> str:
    value = (sensor.moved_mm or {}).get(channel)
    return _figure(value, 4) if unit == MM or value is None else digits(value, 4)


def _share(sensor: SensorResult) -> str:
    return "-" if sensor.share is None else f"{100 * sensor.share:.0f} %"


def _place(place_mm: PlaceMm | None) -> str:
    return ", ".join(_figure(at_mm, 1) for at_mm in place_mm.values()) if place_mm else "-"


def _middles(place: PlaceResult) -> PlaceMm:
    return {axis: middle_mm for axis, (middle_mm, _, _) in (place.stated_mm or {}).items()}


def _interval(place: PlaceResult) -> str:
    spans = (place.stated_mm or {}).values()
    return ", ".join(f"{low_mm:.1f} ... {high_mm:.1f}" for _, low_mm, high_mm in spans) or "-"
