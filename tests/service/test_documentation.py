"""The OpenAPI description says what the service does."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_service.contact import Contact
from beamtouch_service.problems import MEDIA_TYPE, Kind, ProblemBody
from beamtouch_service.samples import Batch

if TYPE_CHECKING:
    from service.conftest import Bench


@pytest.fixture
def description(bench: Bench) -> dict[str, Any]:
    content: dict[str, Any] = bench.get("/openapi.json").json()
    assert bench.get("/openapi.json").json() == content
    return content


def test_every_reference_leads_somewhere(description: dict[str, Any]) -> None:
    schemas = description["components"]["schemas"]
    references = {part.split('"')[0] for part in json.dumps(description).split('"#/components/schemas/')[1:]}

    assert references <= set(schemas)
    assert "HTTPValidationError" not in schemas


def test_the_examples_of_a_contact_are_contacts(description: dict[str, Any]) -> None:
    examples = description["paths"]["/contact"]["get"]["responses"]["200"]["content"]["application/json"]["examples"]

    states = {name: Contact.model_validate(example["value"]).state.value for name, example in examples.items()}
    assert states == {"contact": "contact", "clear": "clear", "degraded": "contact"}


def test_the_example_of_a_batch_is_a_batch_and_its_route_needs_the_token(description: dict[str, Any]) -> None:
    operation = description["paths"]["/surfaces/{name}/samples"]["post"]
    (example,) = operation["requestBody"]["content"]["application/json"]["examples"].values()

    Batch.model_validate_json(json.dumps(example["value"]))
    assert operation["security"] == [{"token": []}]
    assert description["components"]["securitySchemes"]["token"]["scheme"] == "bearer"


def test_every_problem_of_every_route_has_an_example(description: dict[str, Any]) -> None:
    kinds = {kind.slug: kind for kind in Kind}
    seen = set()
    for path in description["paths"].values():
        for operation in path.values():
            assert operation["description"]
            for status, response in operation["responses"].items():
                for slug, example in response["content"].get(MEDIA_TYPE, {}).get("examples", {}).items():
                    body = ProblemBody.model_validate(example["value"])
                    assert (body.type, str(body.status)) == (kinds[slug].type_uri, status)
                    seen.add(kinds[slug])
    # Of these every answer may be one, or what it answers is no request.
    assert set(Kind) - seen == {Kind.BAD_REQUEST, Kind.NOT_FOUND, Kind.METHOD_NOT_ALLOWED, Kind.INTERNAL}
