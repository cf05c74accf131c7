"""The figures of a contact: one row each, from which every output and its documents are made.

JSON and OpenAPI, the stream, MQTT and Home Assistant, Modbus registers, OPC UA variables and the large figures of the
page have what stands here, and nothing else of a contact. Figures of place are named after their axis: `position_mm` on
a beam, `x_mm` and `y_mm` on a plate.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import nan
from typing import Any, Literal, NamedTuple

from pydantic_core import to_json

from beamtouch_common.outline import BEAM_AXES, BEAM_AXIS, PLATE_AXES, Span, names_of
from beamtouch_common.zones import ZoneState
from beamtouch_models.runtime import State
from beamtouch_service import fields
from beamtouch_service.samples import Note
from beamtouch_service.surfaces.contact import ContactQuality, rfc3339
from beamtouch_service.surfaces.view import View

Rows = tuple[tuple[str, str], ...]
"""Meanings of a figure and of the ends of its interval, each in JSON and in registers."""
_EXAMPLES = {
    BEAM_AXIS: (159.9537, 156.3935, 163.1453),
    "x": (152.1043, 148.9812, 155.2507),
    "y": (71.3206, 69.0148, 73.6811),
    "force": (6.4978, 6.4382, 6.5573),
}
"""Figure -> an example of it, with its interval."""
_NOTES = " ".join(
    [
        "Limits of the answer.",
        *(f"`{note}`: {note.meaning}." for note in Note),
        "`check-NAME`, only with `unexplained`: channel NAME contradicts the others.",
    ]
)


class Cell(NamedTuple):
    """The Modbus registers of a field."""

    offset: int
    """Of the first of them in the block of a surface."""
    type: Literal["uint16", "uint32", "float32"]
    words: str
    """The value, as the map of the registers describes it."""
    absent: float = nan
    """The value where there is none."""


@dataclass(frozen=True, slots=True)
class Field(fields.Field[View]):
    """One field of a contact."""

    register: Cell | None = None
    entity: str = ""
    """Its sensor in Home Assistant; empty if it has none."""
    ends: tuple[str, str] | None = None
    """Names of the ends of its interval; None if it has none."""


def _spans(figure: str, unit: str, offset: int, get: Callable[[View], Span | None], rows: Rows) -> tuple[Field, ...]:
    """Return the fields of a figure with its interval, whose registers begin at an offset."""

    def end_of(index: int) -> Callable[[View], float | None]:
        return lambda view: (span := get(view)) and span[index]

    names = names_of(figure, unit.lower())
    middle, *ends = (
        Field(
            each,
            float | None,
            meaning,
            end_of(index),
            unit=unit,
            example=_EXAMPLES[figure][index],
            register=Cell(offset + 2 * index, "float32", words),
        )
        for index, (each, (meaning, words)) in enumerate(zip(names, rows, strict=True))
    )
    label = figure if figure in PLATE_AXES else figure.capitalize()
    return (replace(middle, entity=figure, label=label, ends=names[1:]), *ends)


_INTERVAL = (
    ("Lower end of the 95 % interval.", "lower end of the 95 % interval; NaN as above"),
    ("Upper end of the 95 % interval.", "upper end; NaN as above"),
)


def _place(axis: str, offset: int) -> tuple[Field, ...]:
    meaning, words = f"Distance from the edge, along {axis}", f"along {axis}, on a surface of two axes"
    if axis == BEAM_AXIS:
        meaning, words = "Distance from the left end of the beam", "from the left end of the beam"
    first = f"{meaning}. Null unless the state is `contact`.", f"{words}; NaN unless the state is 2"
    return _spans(axis, "mm", offset, lambda view: view.place.get(axis), (first, *_INTERVAL))


def _force() -> tuple[Field, ...]:
    meaning = "Force of the contact. Null without a contact, or if the model does not estimate force."
    words = "NaN as above, and if the model estimates no force"
    return _spans("force", "N", 14, lambda view: view.force, ((meaning, words), *_INTERVAL))


_CORRELATION = Field(
    "place_correlation",
    float | None,
    "Correlation of the two coordinates, -1 to 1: with the intervals, it makes the ellipse that holds 95 %. Null "
    "unless the state is `contact`, or if the model does not estimate it.",
    lambda view: view.correlation,
    example=0.3127,
)


@cache
def fields_of(axes: tuple[str, ...] = BEAM_AXES) -> tuple[Field, ...]:
    """Return the fields of a contact on a surface with these axes, in their order in JSON."""
    return (
        Field("surface", str, "Name of the surface.", lambda view: view.surface, is_variable=False, example="bench"),
        Field(
            "state",
            State,
            "State of the surface. `contact`: one contact explains the sample. `clear`: the beam rests. `unexplained`: "
            "neither rest nor a single contact explains the sample.",
            lambda view: view.state and view.state.value,
            example=State.CONTACT.value,
        ),
        # Registers keep their offsets for good: those of a second axis came later.
        *(field for axis, offset in zip(axes, (8, 50), strict=False) for field in _place(axis, offset)),
        *([_CORRELATION] if len(axes) > 1 else []),
        *_force(),
        Field(
            "age_ms",
            float,
            "Age of the sample at the time of answering, on the monotonic clocks of sender and service.",
            lambda view: view.age_ms,
            unit="ms",
            label="Age",
            example=6.2,
            register=Cell(
                4, "uint16", "age of the newest sample, rounded up; 65535: more, or no sample", absent=0xFFFF
            ),
        ),
        Field(
            "sampled_at",
            str,
            "Time of the sample by the sender's clock (RFC 3339). It never decides freshness.",
            lambda view: rfc3339(view.newest.sample.acquired_unix_us) if view.newest else None,
            is_variable=False,
            example="2026-11-22T12:48:40.947Z",
        ),
        Field(
            "sequence",
            int,
            "The sample's number since the sender started.",
            lambda view: view.sequence,
            example=3588,
            register=Cell(6, "uint32", "number of the newest sample, its lower 32 bits; 0 before the first", absent=0),
        ),
        Field(
            "readings",
            int | None,
            "Number of readings in the sample; null if its sender does not say. It grows while a contact rests.",
            lambda view: view.readings,
            example=132,
            register=Cell(5, "uint16", "readings in the sample; 65535: or more; 0: not known", absent=0),
            is_variable=False,
        ),
        Field(
            "misfit",
            float,
            "Misfit of rest or of the best single contact, whichever is smaller. `misfit_limit` of "
            "`GET /surfaces/NAME` is its scale: where it is larger than that, neither explains the sample.",
            lambda view: view.misfit,
            example=0.12,
        ),
        Field(
            "quality",
            ContactQuality,
            "`good`: all channels took part. `degraded`: some did not.",
            lambda view: (ContactQuality.DEGRADED if view.bad else ContactQuality.GOOD).value,
            is_variable=False,
            example=ContactQuality.GOOD.value,
        ),
        Field(
            "degraded_channels",
            list[str],
            "Channels that took no part; empty if the quality is good.",
            lambda view: list(view.bad),
            example=[],
        ),
        Field("notes", list[str], _NOTES, lambda view: view.notes, example=[]),
        Field(
            "model",
            str,
            "Name and fingerprint of the model that gave the answer.",
            lambda view: view.answered_by,
            example="bench@cf9246",
        ),
        Field(
            "zones",
            dict[str, ZoneState | None],
            "Zone of the configuration -> `inside`: all of the interval has been in it for as long as its dwell. "
            "`outside`: none of it is, or the beam is clear. `unsure`: neither. Null where no contact can be judged. "
            "Left out if no zones are configured.",
            lambda view: {name: answer and answer.value for name, answer in view.zones.items()},
            is_variable=False,
            is_optional=True,
        ),
    )


_WORDS = "State of the surface; place and force of a contact with their intervals; age and origin of the answer."
Contact = fields.model_of("Contact", _WORDS, fields_of())
"""The contact on a beam."""
PlateContact = fields.model_of("PlateContact", _WORDS, fields_of(PLATE_AXES))
"""The contact on a plate."""


def members_of(view: View) -> dict[str, Any]:
    """Return the members of a contact as JSON values; raises ProblemError if a problem prevents it."""
    return fields.members_of(fields_of(view.require_contact().axes), view)


def encode(view: View) -> bytes:
    """Return a contact as JSON; raises ProblemError if a problem prevents it."""
    return to_json(members_of(view))
