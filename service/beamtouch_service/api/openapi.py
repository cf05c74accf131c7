"""OpenAPI details that signatures of routes do not give: problems, the batch, and roles."""

import json
from typing import Any

from pydantic.json_schema import models_json_schema

from beamtouch_service.api import examples
from beamtouch_service.problems import MEDIA_TYPE, Kind, Problem, ProblemBody
from beamtouch_service.samples import Batch

DESCRIPTION = (
    "Is something touching the beam, where, how hard, and how sure are we. A daemon posts samples; `GET /contact` "
    "answers from the newest one, and never from one older than the limit of the surface. Lengths are in mm from "
    "the left end of the beam, forces in N, ages in ms. Every error is problem+json (RFC 9457): decide by its `type`, "
    "read its `detail`."
)

_REFERENCE = "#/components/schemas/{model}"
EVENTS: dict[str, Any] = {
    "description": "Events, the newest first.",
    "content": {
        "application/json": {
            "examples": {
                "one contact, and more behind it": {"value": {"events": [examples.EVENT], "next": examples.NEXT}},
                "with path=true": {"value": {"events": [examples.EVENT_WITH_PATH], "next": examples.NEXT}},
            }
        },
        "text/csv": {
            "schema": {"type": "string"},
            "examples": {"one contact": {"value": examples.CSV}},
        },
    },
}
"""The answer of the route of the events."""

EVENT: dict[str, Any] = {
    "description": "The event.",
    "content": {"application/json": {"examples": {"one contact": {"value": examples.EVENT_WITH_PATH}}}},
}
"""The answer of the route of one event."""

BATCH_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"$ref": _REFERENCE.format(model="Batch")},
                "examples": {"one sample, one broken channel": {"value": examples.BATCH}},
            }
        },
    },
}
"""For a route that reads its body itself."""


def problems(*kinds: Kind) -> dict[int | str, dict[str, Any]]:
    """Return the `responses` of a route that can end in problems of these kinds, an example for each."""
    responses: dict[int | str, dict[str, Any]] = {}
    for kind in kinds:
        empty = {"schema": {"$ref": _REFERENCE.format(model="Problem")}, "examples": {}}
        response = responses.setdefault(kind.status, {"description": "", "content": {MEDIA_TYPE: empty}})
        response["description"] = "; or ".join(filter(None, [response["description"], kind.title]))
        problem = examples.PROBLEMS.get(kind) or Problem(kind, "The cause, and what to do about it.")
        response["content"][MEDIA_TYPE]["examples"][kind.slug] = {"value": problem.body()}
    # Covers every other problem, and keeps the framework from describing a 422 that no route gives.
    content = {MEDIA_TYPE: {"schema": {"$ref": _REFERENCE.format(model="Problem")}}}
    return {**responses, "default": {"description": "Any other problem.", "content": content}}


def complete(description: dict[str, Any], *, needs_read_token: bool) -> None:
    """Complete an OpenAPI description in place.

    Parameters
    ----------
    description : as the framework makes it; gets the schemas that routes refer to by name, and examples with nulls
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
    _add_examples(description)


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
        # The other token reads too. An empty requirement: also without a token.
        security += [{"write_token": []}]
        security[:0] = [] if needs_read_token else [{}]
    if is_read and not needs_read_token:
        return
    kinds = (Kind.UNAUTHORIZED,) if is_read else (Kind.UNAUTHORIZED, Kind.FORBIDDEN)
    responses = {str(status): response for status, response in problems(*kinds).items() if status != "default"}
    challenge = {"description": "`Bearer` and the realm.", "schema": {"type": "string"}}
    responses[str(Kind.UNAUTHORIZED.status)]["headers"] = {"WWW-Authenticate": challenge}
    operation["responses"] = {**responses, **operation["responses"]}


def _add_examples(description: dict[str, Any]) -> None:
    # Not at the routes: the framework drops every null from examples there, and a clear contact or a stretch has many.
    contacts = {
        "contact": examples.CONTACT,
        "clear": examples.CLEAR,
        "unexplained": examples.UNEXPLAINED,
        "degraded": examples.DEGRADED,
    }
    for path, operations in description["paths"].items():
        if path.endswith("/contact"):
            content = operations["get"]["responses"]["200"]["content"]["application/json"]
            content["examples"] = {name: {"value": value} for name, value in contacts.items()}
    stretch = {"value": {"events": [examples.STRETCH], "next": None}}
    content = description["paths"]["/events"]["get"]["responses"]["200"]["content"]["application/json"]
    content["examples"]["an unexplained stretch"] = stretch
    content = description["paths"]["/events/{id}"]["get"]["responses"]["200"]["content"]["application/json"]
    content["examples"]["an unexplained stretch"] = {"value": examples.STRETCH_WITH_PATH}
