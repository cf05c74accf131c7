"""All kinds of problems that the service answers with, as problem details (RFC 9457).

A problem is a value. `ProblemError` carries it through the code, and `api.errors` turns it into an answer.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import cast

from pydantic import BaseModel, ConfigDict, Field

TYPE_PREFIX = "urn:beamtouch:problem:"
MEDIA_TYPE = "application/problem+json"
_CAUSES = ("bad_channels", "channels_out", "changed_channels")
"""Members that name the channels that are the cause."""


class Kind(Enum):
    """Kinds of problems: the last part of the `type`, the HTTP status, and the title."""

    NO_SURFACE = ("no-surface", 503, "The service has no surface")
    NO_MODEL = ("no-model", 503, "The surface has no model")
    NO_SAMPLES = ("no-samples", 503, "The surface has no samples yet")
    OTHER_BEAM = ("other-beam", 503, "The model is of another beam than the samples")
    STALE = ("stale", 503, "The newest sample is too old")
    TOO_FEW_CHANNELS = ("too-few-channels", 503, "Too few working channels")
    UNUSABLE_ESTIMATE = ("unusable-estimate", 503, "The model gave no usable answer")
    CHANNELS_OUT = ("channels-out", 503, "Sensors have failed")
    CHANGED_CHANNELS = ("changed-channels", 503, "Sensors of the surface have changed")
    ZEROS_MOVED = ("zeros-moved", 503, "The zeros of the surface have moved")
    UNEXPLAINED = ("unexplained", 503, "The surface has been unexplained for too long")
    NOT_READY = ("not-ready", 503, "The service is not ready")
    UNAUTHORIZED = ("unauthorized", 401, "A valid bearer token is required")
    FORBIDDEN = ("forbidden", 403, "The token is for another purpose")
    UNKNOWN_SURFACE = ("unknown-surface", 404, "There is no such surface")
    UNKNOWN_EVENT = ("unknown-event", 404, "There is no such event")
    NO_COMMISSIONING = ("no-commissioning", 404, "There is no such commissioning")
    OTHER_COMMISSIONING = ("other-commissioning", 409, "The commissioning is at another step")
    WRONG_REPLICA = ("wrong-replica", 421, "This service has only some of the surfaces")
    SURFACE_REQUIRED = ("surface-required", 400, "There are several surfaces; name one")
    MALFORMED_JSON = ("malformed-json", 400, "The body is not JSON")
    INVALID_REQUEST = ("invalid-request", 422, "The request has a wrong format")
    MISSING_CHANNELS = ("missing-channels", 422, "The batch lacks channels of the model")
    MALFORMED_ENCODING = ("malformed-encoding", 400, "The body is not compressed as it says")
    UNKNOWN_ENCODING = ("unknown-encoding", 415, "Unsupported Content-Encoding")
    TOO_LARGE = ("too-large", 413, "The body is too large")
    TOO_SLOW = ("too-slow", 408, "The body took too long to arrive")
    RECORD_UNAVAILABLE = ("record-unavailable", 503, "The record of events is unavailable")
    NOT_FOUND = ("not-found", 404, "Nothing is at this address")
    METHOD_NOT_ALLOWED = ("method-not-allowed", 405, "This address does not accept the method")
    OTHER_NAME = ("other-name", 421, "The service does not go by this name")
    STOPPING = ("stopping", 503, "The service is stopping")
    TOO_MANY_CLIENTS = ("too-many-clients", 503, "Too many clients at once")
    INTERNAL = ("internal", 500, "The service failed")

    def __init__(self, slug: str, status: int, title: str) -> None:
        self.slug = slug
        self.status = status
        self.title = title

    @property
    def type_uri(self) -> str:
        """The `type` member, the same for every problem of this kind."""
        return TYPE_PREFIX + self.slug


class ProblemBody(BaseModel):
    """Problem details (RFC 9457); kinds of problems add members of their own."""

    model_config = ConfigDict(extra="allow", title="Problem", use_attribute_docstrings=True)

    type: str = Field(examples=[Kind.STALE.type_uri])
    """The kind of problem. Programs decide by this member alone."""
    title: str
    """The kind in words, the same for every problem of this kind."""
    status: int
    """The status of the HTTP answer."""
    detail: str
    """The cause, and what to do about it."""
    surface: str | None = None
    """The surface concerned, if there is one."""


@dataclass(frozen=True)
class Problem:
    """One problem with its cause."""

    kind: Kind
    detail: str
    """The cause, and what to do about it."""
    surface: str | None = None
    members: Mapping[str, object] = field(default_factory=dict)
    """Further members of the body, JSON values."""

    @property
    def channels(self) -> list[str]:
        """The channels that are the cause, or are suspected to be, if some are."""
        suspect = self.members.get("suspect")
        named = (*(self.members.get(member, ()) for member in _CAUSES), [suspect] if suspect else ())
        return [name for names in named for name in cast("Iterable[str]", names)]

    def body(self) -> dict[str, object]:
        """Return the members of the answer. `surface` is present only if there is one."""
        named = {} if self.surface is None else {"surface": self.surface}
        return {
            "type": self.kind.type_uri,
            "title": self.kind.title,
            "status": self.kind.status,
            "detail": self.detail,
            **named,
            **self.members,
        }


class ProblemError(Exception):
    """Ends a request with a problem."""

    def __init__(self, problem: Problem, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(problem.detail)
        self.problem = problem
        self.headers = dict(headers or {})
