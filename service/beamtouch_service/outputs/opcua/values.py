"""A surface as its variables show it at one time: values, status codes and times. Pure: no clock, no network.

Only what can be relied on is Good. A contact with a note is Uncertain; where there is no contact to judge, everything
is Bad, with a code that says why.
"""

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import NamedTuple

from asyncua import ua

from beamtouch_models.runtime import State
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.contact import Figures
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.view import View

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
    """A variable of a surface."""

    kind: ua.VariantType
    of: Callable[[View], object]
    """Its value; None if there is none."""
    meaning: str


def _figure(name: str) -> Callable[[View], object]:
    return lambda view: getattr(view.figures, name)


VARIABLES: Mapping[str, Variable] = {
    "state": Variable(ua.VariantType.String, lambda view: view.state, "contact, clear or unexplained"),
    **{
        name: Variable(ua.VariantType.Double, _figure(name), f"{words}, while there is a contact")
        for name, words in zip(
            Figures._fields,
            [
                f"{part}{figure}"
                for figure in ("position from the left end [mm]", "force [N]")
                for part in ("", "lower end of the 95 % interval of the ", "upper end of the 95 % interval of the ")
            ],
            strict=True,
        )
    },
    "age_ms": Variable(ua.VariantType.Double, lambda view: view.age_ms, "age of the sample [ms]"),
    "sequence": Variable(ua.VariantType.UInt64, lambda view: view.sequence, "number of the sample"),
    "misfit": Variable(ua.VariantType.Double, lambda view: view.misfit, "misfit of rest or of the best contact"),
    "notes": Variable(ua.VariantType.String, lambda view: " ".join(view.notes), "limits of the answer, as words"),
    "degraded_channels": Variable(ua.VariantType.String, lambda view: " ".join(view.bad), "channels that took no part"),
    "model": Variable(ua.VariantType.String, lambda view: view.answered_by, "the model that gave the answer"),
}
"""Name -> variable, of every surface. All belong to one sample."""


def variables_of(surface: Surface) -> dict[str, Variable]:
    """Return the variables of a surface: those of every contact, and one for each of its zones."""
    return {**VARIABLES, **{f"zones/{name}": _zone(name) for name in surface.section.zones}}


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
