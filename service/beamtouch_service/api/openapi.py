"""OpenAPI details that signatures of routes do not give: examples, problems, the batch."""

import json
from typing import Any

from pydantic.json_schema import models_json_schema

from beamtouch_service.problems import MEDIA_TYPE, Kind, Problem, ProblemBody
from beamtouch_service.samples import Batch

DESCRIPTION = (
    "Is something touching the beam, where, how hard, and how sure are we. A daemon posts samples; `GET /contact` "
    "answers from the newest one, and never from one older than the limit of the surface. Lengths are in mm from "
    "the left end of the beam, forces in N, ages in ms. Every error is problem+json (RFC 9457): decide by its `type`, "
    "read its `detail`."
)

_REFERENCE = "#/components/schemas/{model}"
_CONTACT = {
    "surface": "press-7",
    "state": "contact",
    "position_mm": 123.4,
    "position_low_mm": 121.9,
    "position_high_mm": 125.0,
    "force_n": 9.8,
    "force_low_n": 9.5,
    "force_high_n": 10.1,
    "age_ms": 12.3,
    "sampled_at": "2026-11-20T23:40:46.123Z",
    "sequence": 4711,
    "quality": "good",
    "degraded_channels": [],
    "notes": [],
    "model": "paper@4f2c91",
}
_FIGURES = [name for name in _CONTACT if name.startswith(("position_", "force_"))]
_CLEAR = _CONTACT | dict.fromkeys(_FIGURES) | {"state": "clear"}
_DEGRADED = _CONTACT | {"quality": "degraded", "degraded_channels": ["s3"]}

_STATE = {
    "surface": "press-7",
    "contact": _CLEAR,
    "problem": None,
    "age_ms": 12.3,
    "channels": [{"name": "s1", "position_mm": 100.0, "deflection_mm": 0.0, "quality": "good"}],
    "length_mm": 400.0,
    "sequence": 4711,
}
STATE_EVENT = f"event: state\ndata: {json.dumps(_STATE)}\n\n"
"""One event of the stream."""

_BATCH = {
    "boot_id": "6f1d2c84-0b7e-4a53",
    "channels": ["s1", "s2", "s3"],
    "newest_age_ms": 3.2,
    "samples": [
        {
            "sequence": 4711,
            "acquired_unix_us": 1795218046123000,
            "deflection_mm": [0.112, 0.243, None],
            "quality": ["good", "good", "missing"],
        }
    ],
}

_EVENT = {
    "id": 42,
    "surface": "press-7",
    "touched_at": "2026-11-20T23:40:46.123Z",
    "lifted_at": "2026-11-20T23:40:47.373Z",
    "begin": "touch",
    "end": "lift",
    "dwell_ms": 1250.0,
    "peak_force_n": 9.8,
    "peak_position_mm": 123.4,
    "mean_position_mm": 123.1,
    "samples": 250,
    "quality": "good",
    "model": "paper@4f2c91",
    "boot_id": "6f1d2c84-0b7e-4a53",
}
_EVENT_WITH_PATH = _EVENT | {"path": [{"at": "2026-11-20T23:40:46.123Z", "position_mm": 123.4, "force_n": 9.8}]}
_NEXT = "1795218046123000.42"
EVENTS: dict[str, Any] = {
    "description": "Events, the newest touch first.",
    "content": {
        "application/json": {
            "examples": {
                "one contact, and more behind it": {"value": {"events": [_EVENT], "next": _NEXT}},
                "with path=true": {"value": {"events": [_EVENT_WITH_PATH], "next": _NEXT}},
            }
        },
        "text/csv": {
            "schema": {"type": "string"},
            "examples": {
                "one contact": {"value": ",".join(_EVENT) + "\r\n" + ",".join(map(str, _EVENT.values())) + "\r\n"}
            },
        },
    },
}
"""The answer of the route of the events."""

EVENT: dict[str, Any] = {
    "description": "The event.",
    "content": {"application/json": {"examples": {"one contact": {"value": _EVENT_WITH_PATH}}}},
}
"""The answer of the route of one event."""

BATCH_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"$ref": _REFERENCE.format(model="Batch")},
                "examples": {"one sample, one broken channel": {"value": _BATCH}},
            }
        },
    },
}
"""For a route that reads its body itself."""

_DETAILS = {
    Kind.STALE: Problem(
        Kind.STALE,
        "The newest sample is 2140.7 ms old; the limit is 500 ms. Check that the daemon runs and reaches the device.",
        "press-7",
        {"age_ms": 2140.7, "stale_ms": 500.0},
    ),
    Kind.TOO_FEW_CHANNELS: Problem(
        Kind.TOO_FEW_CHANNELS,
        "Only 1 channel works; the model needs 2. Check s2 (stuck), s3 (missing).",
        "press-7",
        {"bad_channels": {"s2": "stuck", "s3": "missing"}},
    ),
    Kind.MISSING_CHANNELS: Problem(
        Kind.MISSING_CHANNELS,
        "The batch lacks s3. Send every channel of the model; mark a broken one as missing.",
        "press-7",
        {"missing_channels": ["s3"]},
    ),
    Kind.INVALID_REQUEST: Problem(
        Kind.INVALID_REQUEST,
        "#/newest_age_ms: Input should be greater than or equal to 0",
        members={
            "errors": [{"pointer": "#/newest_age_ms", "detail": "Input should be greater than or equal to 0"}],
        },
    ),
}


def problems(*kinds: Kind) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of a route that can end in problems of these kinds, an example for each."""
    responses: dict[int | str, dict[str, Any]] = {}
    for kind in kinds:
        empty = {"schema": {"$ref": _REFERENCE.format(model="Problem")}, "examples": {}}
        response = responses.setdefault(kind.status, {"description": "", "content": {MEDIA_TYPE: empty}})
        response["description"] = "; or ".join(filter(None, [response["description"], kind.title]))
        problem = _DETAILS.get(kind) or Problem(kind, "The cause, and what to do about it.")
        response["content"][MEDIA_TYPE]["examples"][kind.slug] = {"value": problem.body()}
    # Covers every other problem, and keeps the framework from describing a 422 that no route gives.
    content = {MEDIA_TYPE: {"schema": {"$ref": _REFERENCE.format(model="Problem")}}}
    return {**responses, "default": {"description": "Any other problem.", "content": content}}


def complete(description: dict[str, Any], *, needs_read_token: bool) -> None:
    """Complete an OpenAPI description in place.

    Parameters
    ----------
    description : as the framework makes it; gets the schemas that routes refer to by name, and examples of a contact
    needs_read_token : whether reading takes a token in this service
    """
    _, schemas = models_json_schema([(Batch, "validation"), (ProblemBody, "validation")], ref_template=_REFERENCE)
    components = description.setdefault("components", {})
    # In the code `Problem` is the value. Outside there is only its body, so the shorter name is free.
    renamed = {"Problem" if name == "ProblemBody" else name: schema for name, schema in schemas["$defs"].items()}
    components.setdefault("schemas", {}).update(renamed)
    for operations in description["paths"].values():
        for operation in operations.values():
            _add_refusals(operation, needs_read_token=needs_read_token)
    _add_contact_examples(description)


def encoded(description: dict[str, Any]) -> bytes:
    """Return a description as JSON."""
    return json.dumps(description, ensure_ascii=False).encode()


def _add_refusals(operation: dict[str, Any], *, needs_read_token: bool) -> None:
    """Say how an operation refuses other tokens than those it takes."""
    security = operation.setdefault("security", [])
    if not security:
        return
    is_read = {"read_token": []} in security
    if is_read:
        # The other tokens read too. An empty requirement: also without a token.
        security += [{"write_token": []}, {"admin_token": []}]
        security[:0] = [] if needs_read_token else [{}]
    if is_read and not needs_read_token:
        return
    kinds = (Kind.UNAUTHORIZED,) if is_read else (Kind.UNAUTHORIZED, Kind.FORBIDDEN)
    responses = {str(status): response for status, response in problems(*kinds).items() if status != "default"}
    challenge = {"description": "`Bearer` and the realm.", "schema": {"type": "string"}}
    responses[str(Kind.UNAUTHORIZED.status)]["headers"] = {"WWW-Authenticate": challenge}
    operation["responses"] = {**responses, **operation["responses"]}


def _add_contact_examples(description: dict[str, Any]) -> None:
    # Not at the routes: the framework drops every null from examples there, and a clear contact has many.
    examples = {"contact": _CONTACT, "clear": _CLEAR, "degraded": _DEGRADED}
    for path, operations in description["paths"].items():
        if path.endswith("/contact"):
            content = operations["get"]["responses"]["200"]["content"]["application/json"]
            content["examples"] = {name: {"value": value} for name, value in examples.items()}
