"""OpenAPI details that signatures of routes do not give: problems, the batch, and who may read."""

from typing import Any

from pydantic.json_schema import models_json_schema

from beamtouch_service.access import Access, Role
from beamtouch_service.problems import MEDIA_TYPE, ProblemBody
from beamtouch_service.samples import Batch

DESCRIPTION = (
    "Is something touching the beam or the plate, where, how hard, and how sure are we. A daemon posts samples; "
    "`GET /contact` answers from the newest one, and never from one older than the limit of the surface. Places are in "
    "mm from the left end of a beam, or from the edges of a plate along `x` and `y`; forces in N, ages in ms. Every "
    "error is problem+json (RFC 9457): decide by its `type`, read its `detail`."
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


def complete(description: dict[str, Any], access: Access) -> None:
    """Complete an OpenAPI description in place.

    Parameters
    ----------
    description : as the framework makes it; gets the schemas that routes refer to by name
    access : the tokens of this service
    """
    # From where the description is: a proxy may have the service below a path of its own.
    description["servers"] = [{"url": "."}]
    _, named = models_json_schema([(Batch, "validation"), (ProblemBody, "validation")], ref_template=_REFERENCE)
    schemas = description.setdefault("components", {}).setdefault("schemas", {})
    # In the code `Problem` is the value. Outside there is only its body, so the shorter name is free.
    schemas |= {"Problem" if name == "ProblemBody" else name: schema for name, schema in named["$defs"].items()}
    for operations in description["paths"].values():
        for operation in operations.values():
            security = operation.setdefault("security", [])
            for role in [role for role in Role if {f"{role.token}_token": []} in security]:
                # An empty requirement: also without a token.
                is_open = role is Role.READ and not access.read
                security[:] = [{}] if is_open else []
                security += [{f"{one.token}_token": []} for one in access.sufficient(role)]
