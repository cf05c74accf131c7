"""The OpenAPI description says what the service does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from fastapi.routing import iter_route_contexts
from fastapi.testclient import TestClient

from beamtouch_service.access import Access
from beamtouch_service.api.app import create_app
from beamtouch_service.api.events import Event
from beamtouch_service.api.page import FOLDER
from beamtouch_service.problems import MEDIA_TYPE
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.surface import Surface

from .conftest import READ_TOKEN, TOKEN

if TYPE_CHECKING:
    from service.conftest import Bench


MQTT = Path(__file__).parents[2] / "docs" / "how-to" / "mqtt.md"


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


def test_the_example_of_a_batch_is_one(description: dict[str, Any]) -> None:
    (example,) = description["components"]["schemas"]["Batch"]["examples"]
    assert Batch.model_validate_json(json.dumps(example)).boot_id == "6f1d2c84-0b7e-4a53"


def test_the_messages_in_the_document_of_mqtt_have_the_members_of_today() -> None:
    messages = [json.loads(line[line.index("{") :]) for line in MQTT.read_text().splitlines() if line.endswith("}")]
    (contact,) = [message for message in messages if "state" in message]
    (event,) = [message for message in messages if "touched_at" in message]

    assert (list(contact), list(event)) == (list(Contact.model_fields), list(Event.model_fields))
    Contact.model_validate(contact)
    Event.model_validate(event)


def test_every_operation_may_end_in_a_problem(description: dict[str, Any]) -> None:
    for operation in operations_of(description).values():
        assert operation["description"]
        assert set(operation["responses"]) == {"200", "default"}
        assert operation["responses"]["default"]["content"] == {
            MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}
        }


def operations_of(description: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return every operation by its name."""
    return {
        operation["operationId"]: {**operation, "method": method.upper(), "path": path}
        for path, operations in description["paths"].items()
        for method, operation in operations.items()
    }


def test_operations_have_names_that_a_generated_client_can_use(description: dict[str, Any]) -> None:
    assert sorted(operations_of(description)) == [
        "get_beam", "get_calibration_data", "get_contact", "get_event", "get_events", "get_live",
        "get_metrics", "get_model", "get_ready", "get_stream", "get_surface", "get_surface_contact",
        "get_surface_stream", "get_surfaces", "post_samples",
    ]  # fmt: skip
    assert len(operations_of(description)) == sum(len(one) for one in description["paths"].values())
    assert all(len(operation["tags"]) == 1 for operation in operations_of(description).values())


@pytest.mark.parametrize("has_read_token", [False, True])
def test_every_route_says_which_tokens_it_takes_and_does_so(has_read_token: bool) -> None:
    tokens = {"read_token": READ_TOKEN, "write_token": TOKEN}
    access = Access(TOKEN, READ_TOKEN if has_read_token else None)
    client = TestClient(create_app([Surface("press-7")], access))
    answer = client.get("/openapi.json", headers={"Authorization": f"Bearer {TOKEN}"})
    description = answer.json()
    schemes = description["components"]["securitySchemes"]
    assert {name: scheme["scheme"] for name, scheme in schemes.items()} == dict.fromkeys(tokens, "bearer")
    for name, operation in operations_of(description).items():
        if name.endswith("stream"):
            continue  # it would not end
        taken = {scheme for one in operation["security"] for scheme in one}
        is_open = not operation["security"] or {} in operation["security"]
        path = operation["path"].format(name="press-7", id=1)
        for bearer, token in {"": "", "none of them": "wrong", **tokens}.items():
            if bearer == "read_token" and not has_read_token:
                continue
            headers = {"Authorization": f"Bearer {token}"} if token else {}
            answer = client.request(operation["method"], path, headers=headers)
            assert (answer.status_code not in (401, 403)) == (is_open or bearer in taken), (name, bearer)
            assert ("WWW-Authenticate" in answer.headers) == (answer.status_code == 401)


def test_no_route_is_open_but_the_page_and_the_check_that_the_process_answers() -> None:
    app = create_app([Surface("press-7")], Access(TOKEN, READ_TOKEN))
    client = TestClient(app)
    page = {"/" if path.name == "index.html" else f"/{path.name}" for path in FOLDER.iterdir()}
    paths = {str(route.path) for route in iter_route_contexts(app.routes)}
    assert page < paths
    for path in paths - page - {"/health/live"}:
        method = "POST" if path.endswith("/samples") else "GET"
        assert client.request(method, path.format(name="press-7", id=1)).status_code == 401, path
