"""The fields of an event: one row each, from which every output and its documents are made.

JSON and OpenAPI, CSV, MQTT, OPC UA, the columns of the page and the reference have what stands here. Figures of place
are named after their axis, as `mean_position_mm` on a beam.
"""

from collections.abc import Callable
from functools import cache
from itertools import zip_longest
from operator import attrgetter
from types import GenericAlias
from typing import Any

from pydantic import BaseModel, create_model
from pydantic import Field as ModelField
from pydantic_core import to_json

from beamtouch_common.outline import BEAM_AXES, BEAM_AXIS, PLATE_AXES, names_of
from beamtouch_service import fields
from beamtouch_service.fields import Field
from beamtouch_service.record.events.event import Begin, Contradiction, End, Event, EventKind, Numbered
from beamtouch_service.surfaces.contact import ContactQuality, rfc3339


def _stay_of(axes: tuple[str, ...]) -> type[BaseModel]:
    """Return the model of a stay on a surface with these axes."""
    ends = ("Lower end of the 95 % interval.", "Upper end of the 95 % interval.")
    members: dict[str, tuple[object, str]] = {
        "at": (str, "Time of its begin (RFC 3339)."),
        "lasts_ms": (float, "How long it lasted."),
    }
    for axis in axes:
        place = ("Position of the load." if axis == BEAM_AXIS else f"Place of the load along {axis}.", *ends)
        members |= {one: (float, words) for one, words in zip(names_of(axis, "mm"), place, strict=True)}
    force = ("Force of the load; null if the model does not estimate force.", *ends)
    members |= {one: (float | None, words) for one, words in zip(names_of("force", "n"), force, strict=True)}
    members["unsteady"] = (bool, "True if these figures stand on unsteady samples.")
    described: dict[str, Any] = {one: (kind, ModelField(description=words)) for one, (kind, words) in members.items()}
    name = "Stay" if axes == BEAM_AXES else "PlateStay"
    return create_model(name, __doc__="A part of a contact in which one load explains all samples.", **described)


def _stored(name: str, kind: object, meaning: str, unit: str = "", label: str = "") -> Field[Numbered]:
    """Return a field as it is on record."""
    return Field(name, kind, meaning, attrgetter(f"event.{name}"), unit, label=label)


def _places(axis: str) -> tuple[Field[Numbered], ...]:
    """Return the figures of a place along an axis, in their order on record."""
    place = "position" if axis == BEAM_AXIS else f"place along {axis}"
    meanings = (
        f"Mean {place} of the load over its time. Null without a contact.",
        "Lower end of the 95 % interval of this mean.",
        "Upper end of the 95 % interval of this mean.",
        f"Least {place} of a load that moves. Of one that lies still, its {place}.",
        f"Largest {place} of a load that moves. Of one that lies still, its {place}.",
        f"{place.capitalize()} at the peak force. Null if the model does not estimate force.",
    )
    names = (*names_of(f"mean_{axis}", "mm"), f"min_{axis}_mm", f"max_{axis}_mm", f"peak_{axis}_mm")

    def read(index: int) -> Callable[[Numbered], float | None]:
        return lambda numbered: values[index] if (values := numbered.event.place.get(axis)) else None

    return tuple(
        Field(name, float | None, meaning, read(index), "mm", label="" if index else "Mean at")
        for index, (name, meaning) in enumerate(zip(names, meanings, strict=True))
    )


def _force(figure: str, meaning: str, label: str = "") -> tuple[Field[Numbered], ...]:
    """Return the fields of a force with its 95 % interval; `label`: its column on the page."""
    ends = (f"{end} end of the 95 % interval of this force." for end in ("Lower", "Upper"))
    return tuple(
        _stored(name, float | None, words, "N", column)
        for name, words, column in zip(names_of(figure, "n"), (meaning, *ends), (label, "", ""), strict=True)
    )


def _end_us(event: Event) -> int:
    return event.last_us if event.lifted_us is None else event.lifted_us


def _unexplained_ms(event: Event) -> float:
    """Return for how long an event was unexplained, up to its end."""
    rest_us = max(0, _end_us(event) - event.last_us) if event.ends_unexplained else 0
    return round((event.unexplained_us + rest_us) / 1e3, 3)


@cache
def event_fields_of(axes: tuple[str, ...] = BEAM_AXES) -> tuple[Field[Numbered], ...]:
    """Return the fields of an event on a surface with these axes, in their order in JSON and CSV."""
    return (
        Field("id", int, "Number of the event.", lambda numbered: numbered.number),
        _stored("surface", str, "Name of the surface."),
        _stored(
            "kind",
            EventKind,
            "Kind of the event. `contact`: a contact, with the unexplained stretches during it. `unexplained`: a "
            "stretch without a contact before it, which has neither force nor position.",
        ),
        Field(
            "touched_at",
            str,
            "Time of the first sample (RFC 3339).",
            lambda numbered: rfc3339(numbered.event.touched_us),
            label="Began at",
        ),
        Field(
            "lifted_at",
            str | None,
            "Time of the first clear reading after it, or of the first clear sample after an unexplained stretch. Null "
            "if that is not known.",
            lambda numbered: None if numbered.event.lifted_us is None else rfc3339(numbered.event.lifted_us),
        ),
        _stored(
            "begin",
            Begin,
            "How it began. `touch` (a contact) or `clear` (a stretch): the sample before was clear. `unexplained`: a "
            "contact after an unexplained stretch, so its touch was not seen. `unseen`: the sample before is not "
            "known.",
        ),
        _stored(
            "end",
            End,
            "How it ended. `lift` (a contact) or `clear` (a stretch): the sample after it was clear. `unexplained`: a "
            "contact whose last samples are unexplained before a clear one, so it was lifted somewhere in them. "
            "`contact`: a stretch before a contact, which is the next event. `open`: the event continues. `unseen`: "
            "the sample after it is not known, as it is lost or its state is.",
        ),
        Field(
            "dwell_ms",
            float,
            "Time from the first sample to `lifted_at`, or to the last sample if that is null.",
            # The sender's clock may have been set back during the contact.
            lambda numbered: max(0.0, round((_end_us(numbered.event) - numbered.event.touched_us) / 1e3, 3)),
            "ms",
            label="For",
        ),
        Field(
            "unexplained_ms",
            float,
            "The part of `dwell_ms` that was unexplained. It counts in no force and no position.",
            lambda numbered: _unexplained_ms(numbered.event),
            "ms",
        ),
        *(field for axis in axes for field in _places(axis)),
        *_force(
            "mean_force",
            "Mean force of the load over its time, without the ramps of touch and lift. Null if the model does not "
            "estimate force. Times `dwell_ms`, it is the impulse.",
            label="Mean force",
        ),
        *_force("peak_force", "Largest force of the load that lasted. Swings of the beam are none of it."),
        _stored("samples", int, "Number of samples in these figures."),
        _stored("unsteady_samples", int, "Number of these samples that carry the note `unsteady`."),
        _stored("unsteady", bool, "True if the figures stand on unsteady samples. Their intervals hold all the same."),
        Field(
            "quality",
            ContactQuality,
            "`good`: all channels took part. `degraded`: at least one sample lacked channels.",
            lambda numbered: ContactQuality.DEGRADED if numbered.event.degraded else ContactQuality.GOOD,
        ),
        _stored("model", str, "Name and fingerprint of the model that gave the answers."),
        _stored("boot_id", str, "Boot id of the sender: it names one start of it."),
        Field(
            "zones",
            dict[str, float],
            "Zone that the contact was inside -> for how long [ms]. Left out if it was inside none.",
            lambda numbered: {zone: round(us / 1e3, 3) for zone, us in numbered.event.zones.items()},
            is_optional=True,
        ),
    )


@cache
def _with_path(axes: tuple[str, ...]) -> tuple[Field[Numbered], ...]:
    """Return the fields of an event with its path, and with what was unexplained."""
    return (
        *event_fields_of(axes),
        Field(
            "path",
            GenericAlias(list, _stay_of(axes)),
            "The stays of its load, at most 25. Between two of them it moved, or its force changed.",
            lambda numbered: _path(numbered.event),
        ),
        Field(
            "capture",
            list[Contradiction],
            "Its first unexplained samples, channel by channel: at most 5.",
            lambda numbered: numbered.event.capture or [],
        ),
    )


def _path(event: Event) -> list[dict[str, Any]]:
    """Return the path of an event, each point a stay."""
    names = [name for axis in event.place for name in names_of(axis, "mm")] + [*names_of("force", "n")]
    return [
        {
            "at": rfc3339(event.touched_us + round(since_us)),
            "lasts_ms": round(lasts_us / 1e3, 3),
            **dict(zip_longest(names, spans)),
            "unsteady": bool(is_unsteady),
        }
        for since_us, lasts_us, is_unsteady, *spans in event.path
    ]


_WORDS = "One contact from touch to lift, or one unexplained stretch. Times are from the sender's clock, in UTC."
EventAnswer = fields.model_of("Event", _WORDS, event_fields_of())
"""An event on a beam, without its path."""
PlateEvent = fields.model_of("PlateEvent", _WORDS, event_fields_of(PLATE_AXES))
"""An event on a plate, without its path."""
EventWithPath = fields.model_of("EventWithPath", _WORDS, _with_path(BEAM_AXES))
"""An event on a beam, with the path of its contact, and what was unexplained."""
PlateEventWithPath = fields.model_of("PlateEventWithPath", _WORDS, _with_path(PLATE_AXES))
"""An event on a plate, with the path of its contact, and what was unexplained."""


def members_of_event(numbered: Numbered) -> dict[str, Any]:
    """Return the members of an event as JSON values, without its path."""
    return fields.members_of(event_fields_of(tuple(numbered.event.place)), numbered)


def encode_event(numbered: Numbered, *, path: bool = False) -> bytes:
    """Return an event as JSON, with or without its path and its capture."""
    axes = tuple(numbered.event.place)
    return to_json(fields.members_of(_with_path(axes) if path else event_fields_of(axes), numbered))
