"""A surface as its variables show it at one time: values, status codes and times. Pure: no clock, no network.

Only what can be relied on is Good. A contact with a note is Uncertain; where there is no contact to judge, everything
is Bad, with a code that says why.
"""

import json
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple

from asyncua import ua

from beamtouch_models.runtime import State
from beamtouch_service.fields import Field
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.fields import fields_of
from beamtouch_service.surfaces.surface import Surface

_BAD = {
    Kind.STALE: ua.StatusCodes.BadNoCommunication,
    Kind.NO_SAMPLES: ua.StatusCodes.BadWaitingForInitialData,
    Kind.NO_MODEL: ua.StatusCodes.BadConfigurationError,
    Kind.OTHER_BEAM: ua.StatusCodes.BadConfigurationError,
    Kind.TOO_FEW_CHANNELS: ua.StatusCodes.BadSensorFailure,
    Kind.UNUSABLE_ESTIMATE: ua.StatusCodes.BadSensorFailure,
}
"""Why there is no contact."""
GOOD, DOUBTFUL = ua.StatusCodes.Good, ua.StatusCodes.UncertainSubNormal
NO_FIGURE = ua.StatusCodes.BadNoData
"""Of position and force while nothing touches, or nothing explains the readings."""


class Variable(NamedTuple):
    """A variable of a surface, or a property of an event."""

    kind: ua.VariantType
    of: Callable[[Any], object]
    """Returns its value; None if there is none."""
    meaning: str


_KINDS: Mapping[type, ua.VariantType] = {
    bool: ua.VariantType.Boolean,
    float: ua.VariantType.Double,
    int: ua.VariantType.UInt64,
}
"""Types of fields, also where they may be None -> those of variables; all others are text."""


def variable_of(field: Field[Any]) -> Variable:
    """Return the variable of a field of a contact or an event."""
    kind = next((kind for held, kind in _KINDS.items() if field.type in (held, held | None)), ua.VariantType.String)
    words, unit = field.meaning.partition(". ")[0].rstrip("."), f" [{field.unit}]" if field.unit else ""
    of = field.get if kind is not ua.VariantType.String else lambda source: _text(field.get(source))
    return Variable(kind, of, words + unit)


def _text(value: object) -> str | None:
    """Return a value for which OPC UA has no type: words of a list, zones as JSON."""
    if isinstance(value, dict):
        return json.dumps(value)
    return " ".join(value) if isinstance(value, list) else None if value is None else str(value)


def variables_of(surface: Surface) -> dict[str, Variable]:
    """Return the variables of a surface: those of every contact, and one for each of its zones."""
    fields = {field.name: variable_of(field) for field in fields_of(surface.axes) if field.is_variable}
    return {**fields, **{f"zones/{name}": _zone(name) for name in surface.section.zones}}


def _zone(name: str) -> Variable:
    meaning = "inside, outside or unsure, while there is a contact to judge or the beam is clear"
    return Variable(ua.VariantType.String, lambda view: view.zones.get(name), meaning)


def values(surface: Surface, now_s: float, now: datetime) -> dict[str, ua.DataValue]:
    """Return the variables of a surface as of `now_s` [s, monotonic], which is `now` on the clock of the service.

    The source time is the sample's, by the sender's clock; without a sample that counts it is `now`.
    """
    view, variables = surface.view(now_s), variables_of(surface)
    if view.newest is None or view.problem:
        code = _BAD.get(view.problem.kind) if view.problem else None
        status = ua.StatusCode(code or ua.StatusCodes.BadInternalError)
        return {name: _value(None, one.kind, status, now, now) for name, one in variables.items()}
    is_doubtful = view.notes or view.bad or view.state is State.UNEXPLAINED
    status = ua.StatusCode(DOUBTFUL if is_doubtful else GOOD)
    sampled = datetime.fromtimestamp(view.newest.sample.acquired_unix_us // 1000 / 1e3, UTC)
    return {name: _value(one.of(view), one.kind, status, sampled, now) for name, one in variables.items()}


def _value(
    value: object, kind: ua.VariantType, status: ua.StatusCode, sampled: datetime, now: datetime
) -> ua.DataValue:
    if value is None and not status.is_bad():
        status = ua.StatusCode(NO_FIGURE)
    variant = ua.Variant(None, ua.VariantType.Null) if value is None else ua.Variant(value, kind)
    return ua.DataValue(variant, status, SourceTimestamp=sampled, ServerTimestamp=now)
