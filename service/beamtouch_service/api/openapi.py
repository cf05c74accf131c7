"""OpenAPI details that signatures of routes do not give: problems, the batch, examples, and who may read."""

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
PROBLEMS: dict[int | str, dict[str, Any]] = {
    "default": {
        "description": "Any problem.",
        "content": {MEDIA_TYPE: {"schema": {"$ref": _REFERENCE.format(model="Problem")}}},
    }
}
"""The `responses` of every route."""
BATCH_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": _REFERENCE.format(model="Batch")}}},
    },
}
"""For a route that reads its body itself."""

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
    "readings": 40,
    "misfit": 1.8,
    "quality": "good",
    "degraded_channels": [],
    "notes": [],
    "model": "paper@4f2c91",
}
_CLEAR = _CONTACT | {name: None for name in _CONTACT if name.startswith(("position_", "force_"))} | {"state": "clear"}
_UNEXPLAINED = _CLEAR | {"state": "unexplained", "misfit": 412.7, "notes": ["check-s3"]}
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
            "readings": 40,
        }
    ],
}
_EVENT = {
    "id": 42,
    "surface": "press-7",
    "kind": "contact",
    "touched_at": "2026-11-20T23:40:46.123Z",
    "lifted_at": "2026-11-20T23:40:47.373Z",
    "begin": "touch",
    "end": "lift",
    "dwell_ms": 1250.0,
    "unexplained_ms": 0.0,
    "peak_force_n": 9.8,
    "peak_position_mm": 123.4,
    "mean_position_mm": 123.1,
    "samples": 250,
    "unsteady": False,
    "quality": "good",
    "model": "paper@4f2c91",
    "boot_id": "6f1d2c84-0b7e-4a53",
}
_STRETCH = _EVENT | dict.fromkeys(["peak_force_n", "peak_position_mm", "mean_position_mm"])
_STRETCH |= {"kind": "unexplained", "begin": "clear", "end": "clear", "samples": 0, "unexplained_ms": 1250.0}
_STALE = Problem(
    Kind.STALE,
    "The newest sample is 2140.7 ms old; the limit is 500 ms. Check that the daemon runs and reaches the device.",
    "press-7",
    {"age_ms": 2140.7, "stale_ms": 500.0},
)
_EXAMPLES = {
    "Contact": [_CONTACT, _CLEAR, _UNEXPLAINED],
    "Event": [_EVENT, _STRETCH],
    "Batch": [_BATCH],
    "Problem": [_STALE.body()],
}
"""By schema. Not at the models: the framework drops every null there, and a clear contact or a stretch has many."""


def complete(description: dict[str, Any], *, needs_read_token: bool) -> None:
    """Complete an OpenAPI description in place.

    Parameters
    ----------
    description : as the framework makes it; gets the schemas that routes refer to by name, and examples
    needs_read_token : whether reading takes a token in this service
    """
    _, named = models_json_schema([(Batch, "validation"), (ProblemBody, "validation")], ref_template=_REFERENCE)
    schemas = description.setdefault("components", {}).setdefault("schemas", {})
    # In the code `Problem` is the value. Outside there is only its body, so the shorter name is free.
    schemas |= {"Problem" if name == "ProblemBody" else name: schema for name, schema in named["$defs"].items()}
    for name, examples in _EXAMPLES.items():
        schemas[name]["examples"] = examples
    for operations in description["paths"].values():
        for operation in operations.values():
            security = operation.setdefault("security", [])
            if {"read_token": []} in security:
                # The other token reads too. An empty requirement: also without a token.
                security += [{"write_token": []}]
                security[:0] = [] if needs_read_token else [{}]
