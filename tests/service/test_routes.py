"""Questions about surfaces, refusals of what a request must not be, and the OpenAPI description of both."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from beamtouch_models.runtime.metadata import FORCE_OUTPUTS, POSITION_OUTPUTS
from beamtouch_service.api.samples import MAX_BODY_BYTES
from beamtouch_service.fields import example_of
from beamtouch_service.problems import MEDIA_TYPE, Kind
from beamtouch_service.record import EventAnswer
from beamtouch_service.samples import MAX_SAMPLES, Batch
from beamtouch_service.surfaces.fields import Contact, fields_of
from beamtouch_service.surfaces.pace import Pace
from service.bench import START_US, Bench, Row, batch_of, kind, surface_of, surface_with
from service.event_story import TOUCHING
from support.pages.pasted import is_part_of, shown_in
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

MQTT = Path(__file__).parents[2] / "docs" / "how-to" / "mqtt.md"


def test_a_service_without_a_surface_says_so_everywhere() -> None:
    bench = Bench()
    answers = [bench.get("/contact"), bench.get("/surfaces/press-7/contact"), bench.get("/health/ready")]
    for response in [*answers, bench.post(batch_of())]:
        assert (response.status_code, kind(response)) == (503, "no-surface")
    assert bench.get("/surfaces").json() == {"surfaces": []}
    assert bench.get("/health/live").status_code == 200


def test_a_surface_without_a_model_takes_samples_and_says_why_it_gives_nothing() -> None:
    bench = Bench(surface_with(None))
    bench.send([0.5], channels=["any"])
    for path in ("/contact", "/surfaces/press-7/model", "/surfaces/press-7/beam"):
        assert bench.problem(path) == "no-model"
    # A model says nothing of a sample from before it.
    bench.adopt(model_of())
    assert bench.problem() == "no-samples"
    bench.send(boot_id="boot-0002")
    assert bench.contact()["state"] == "contact"


def test_model_and_beam_are_those_in_use(bench: Bench) -> None:
    bench.send()
    before = bench.contact()
    bench.adopt(model_of("other", channels=4))
    model, beam = (bench.get(f"/surfaces/press-7/{what}").json() for what in ("model", "beam"))
    assert (model["channels"], model["positions_mm"]) == (["s1", "s2", "s3", "s4"], [100.0, 200.0, 300.0, 400.0])
    assert model["ranges"] == {"position_mm": [1.0, 399.0], "force_n": [1.0, 20.0]}
    assert model["accuracy"]["limit_percent"] == 1.0
    assert (beam["model"], beam["length_mm"], beam["drawn"]["load_mm"]) == (model["identity"], 400.0, [200.0])
    # The contact so far stays with the model that gave it.
    assert bench.contact() == before
    bench.send([0.5, 0.25, 0.125, 0.0], sequence=2)
    assert bench.contact()["model"] == model["identity"] != before["model"]


@pytest.mark.promise("docs/how-to/several-surfaces.md", "`/contact` without a name is refused, as there are several.")
def test_several_surfaces_must_be_named() -> None:
    bench = Bench(surface_of(), surface_of("press-8"))
    bench.send(surface="press-8")
    response = bench.get("/contact")
    assert (response.status_code, kind(response)) == (400, "surface-required")
    assert response.json()["surfaces"] == ["press-7", "press-8"]
    assert bench.get("/contact?surface=press-8").json()["surface"] == "press-8"
    assert bench.problem("/contact?surface=press-7") == "no-samples"
    assert list(bench.get("/health/ready").json()["surfaces"]) == ["press-7"]


def test_the_summary_of_a_surface(bench: Bench) -> None:
    for sequence in (1, 3, 8):
        bench.send(*[[0.5, 0.25, 0.125]] * 3, sequence=sequence)
    summary = bench.get("/surfaces/press-7").json()
    assert bench.get("/surfaces").json() == {"surfaces": [summary]}
    assert str(summary.pop("model")).startswith("press-7@")
    assert summary == {
        "name": "press-7",
        "beam": "beam-1",
        "channels": ["s1", "s2", "s3"],
        "unit": "mm",
        "stale_ms": 500.0,
        "age_ms": 0.0,
        "state": "contact",
        "problem": None,
        "notes": [],
        "misfit": 0.0,
        "misfit_limit": 30.0,
        "channels_out": {},
        "wiring": None,
        "model_error": None,
        "samples": {"accepted": 8, "repeated": 1, "lost": 2},
        "health": {},
    }


@pytest.mark.parametrize(
    ("path", "problem"),
    [
        ("/contact?surface=nobody", "unknown-surface"),
        ("/surfaces/nobody/contact", "unknown-surface"),
        ("/surfaces/%C3%A9%00", "unknown-surface"),
        ("/surfaces/nobody/stream", "unknown-surface"),
        ("/surfaces/nobody/beam", "unknown-surface"),
        ("/surfaces/nobody/calibration-data", "unknown-surface"),
        ("/nothing", "not-found"),
        ("/contact/", "not-found"),
        ("/docs", "not-found"),
        ("/surfaces/a/b/c", "not-found"),
        ("/stream?interval_ms=19", "invalid-request"),
        ("/stream?interval_ms=5001", "invalid-request"),
        ("/surfaces/press-7/calibration-data?limit=0", "invalid-request"),
    ],
)
def test_an_address_or_a_query_that_does_not_exist_is_a_problem(bench: Bench, path: str, problem: str) -> None:
    response = bench.get(path)
    assert (response.status_code, kind(response)) == (422 if problem == "invalid-request" else 404, problem)


def test_a_wrong_method_is_a_problem_that_names_the_right_one(bench: Bench) -> None:
    for path, allowed in (("/contact", "GET"), ("/surfaces/press-7/commissioning", "GET, POST")):
        response = bench.client.delete(path)
        assert (response.status_code, kind(response)) == (405, "method-not-allowed")
        assert response.headers["allow"] == allowed


@pytest.mark.promise("docs/reference/problems.md", "The service failed")
def test_a_failure_inside_is_a_problem_without_its_traceback(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise RuntimeError(f"secret {arguments}")

    (surface,) = bench.app.context.registry
    for name in ("view", "begin"):
        monkeypatch.setattr(surface, name, fail)
    for response in (bench.get("/surfaces"), bench.post(batch_of())):
        assert (response.status_code, kind(response)) == (500, "internal")
        assert "secret" not in response.text


def test_failures_inside_are_logged_with_their_traceback_once_a_minute_each(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*arguments: object) -> None:
        raise RuntimeError(f"bug {arguments}")

    def fail_otherwise(*_: object) -> None:
        raise KeyError("bug")

    (surface,) = bench.app.context.registry
    monkeypatch.setattr(surface, "begin", fail)
    for sequence in range(1, 21):
        assert kind(bench.post(batch_of(sequence=sequence))) == "internal"
    monkeypatch.setattr(surface, "begin", fail_otherwise)
    assert kind(bench.post(batch_of())) == "internal"
    errors = [one.exc_info[0] for one in caplog.records if one.levelname == "ERROR" and one.exc_info]
    assert errors == [RuntimeError, KeyError]


@pytest.mark.promise("docs/reference/http.md", "The stream sends an event `state` after each change")
def test_a_stream_says_the_state_when_it_changes_and_each_second(bench: Bench) -> None:
    bench.send()
    (surface,) = bench.app.context.registry
    pace, said = Pace([surface], 0.05, tells_status_at_once=False), list[bool]()
    for now_s in (bench.now_s + since_s for since_s in (0.0, 0.1, 0.4, 0.6, 0.7, 1.7)):
        due = pace.due(now_s)
        pace.note_told(due, now_s)
        said.append(bool(due))
    assert said == [True, False, False, True, False, True]  # at 0.6 s the contact is stale


STATUSES = {
    400: "surface-required malformed-json malformed-encoding",
    401: "unauthorized",
    403: "forbidden",
    404: "unknown-surface unknown-event no-commissioning not-found",
    405: "method-not-allowed",
    408: "too-slow",
    409: "other-commissioning",
    413: "too-large",
    415: "unknown-encoding",
    421: "wrong-replica other-name",
    422: "invalid-request missing-channels",
    500: "internal",
    503: "no-surface no-model no-samples other-beam stale too-few-channels unusable-estimate channels-out "
    "changed-channels zeros-moved unexplained not-ready record-unavailable stopping too-many-clients",
}
"""What clients and proxies decide by: the table of `docs/reference/problems.md` is made from the code."""


def test_each_kind_of_problem_has_its_status() -> None:
    found = {one.slug: one.status for one in Kind}
    assert found == {slug: status for status, slugs in STATUSES.items() for slug in slugs.split()}
    assert {one.type_uri for one in Kind} == {f"urn:beamtouch:problem:{slug}" for slug in found}


def accepted(bench: Bench) -> int:
    return int(bench.get("/surfaces/press-7").json()["samples"]["accepted"])


def test_a_batch_holds_so_many_samples_and_no_more(bench: Bench) -> None:
    rows = [[0.5, 0.25, 0.125]] * MAX_SAMPLES
    response = bench.post(batch_of(*rows, [0.0, 0.0, 0.0]))
    assert (response.status_code, kind(response)) == (422, "invalid-request")
    assert response.json()["errors"][0]["pointer"] == "#/samples"
    assert accepted(bench) == 0
    bench.send(*rows)
    assert accepted(bench) == MAX_SAMPLES == 2000


@pytest.mark.promise("docs/reference/problems.md", "`limit_bytes`")
@pytest.mark.parametrize("is_stated", [True, False])
def test_a_body_that_is_too_large_is_refused(bench: Bench, *, is_stated: bool) -> None:
    def chunks() -> Iterator[bytes]:
        for _ in range(MAX_BODY_BYTES // 65536 + 1):
            yield b" " * 65536

    response = bench.post(b" " * (MAX_BODY_BYTES + 1) if is_stated else chunks())
    assert (response.status_code, kind(response)) == (413, "too-large")


@pytest.mark.parametrize("body", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b"not json"])
def test_what_is_not_json_is_malformed(bench: Bench, body: bytes) -> None:
    response = bench.post(body)
    assert (response.status_code, kind(response)) == (400, "malformed-json")
    assert len(response.content) < 1000


@pytest.mark.promise("docs/how-to/upgrade.md", "A service refuses fields that it does not know")
@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"newest_age_ms": -1}, "#/newest_age_ms"),
        ({"newest_age_ms": "1"}, "#/newest_age_ms"),
        ({"newest_age_ms": float("nan")}, "#/newest_age_ms"),
        ({"newest_age_ms": float("inf")}, "#/newest_age_ms"),
        ({"newest_age_ms": None}, "#"),
        ({"backlog": True}, "#"),
        ({"boot_id": "short"}, "#/boot_id"),
        ({"beam": "beam 2"}, "#/beam"),
        ({"notes": ["loud"]}, "#/notes/0"),
        ({"noise_mm": [0.1]}, "#"),
        ({"noise_mm": [0.1, 0.0, 0.1]}, "#/noise_mm/1"),
        ({"noise_mm": [0.1, float("inf"), 0.1]}, "#/noise_mm/1"),
        ({"noise_mm": [0.1, 1.001e4, 0.1]}, "#/noise_mm/1"),
        ({"channels": ["s1", "s1", "s1"]}, "#"),
        ({"channels": ["s1", "s2"]}, "#"),
        ({"surprise": 1}, "#/surprise"),
        ({"a/b~c": 1}, "#/a~1b~0c"),
    ],
)
def test_a_wrong_batch_is_refused_with_the_place_that_is_wrong(
    bench: Bench, change: dict[str, Any], place: str
) -> None:
    response = bench.post(json.dumps(batch_of() | change).encode())
    assert (response.status_code, kind(response)) == (422, "invalid-request")
    assert [error["pointer"] for error in response.json()["errors"]] == [place]
    assert accepted(bench) == 0


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_a_deflection_that_is_not_finite_is_refused(bench: Bench, value: str) -> None:
    response = bench.post(json.dumps(batch_of([0.5, 0.25, 77.0])).replace("77.0", value).encode())
    assert response.status_code == 422
    assert response.json()["errors"][0]["pointer"] == "#/samples/0/deflection_mm/2"


@pytest.mark.promise("docs/reference/problems.md", "`errors` (at most 10)")
def test_a_hugely_wrong_batch_gets_a_short_answer(bench: Bench) -> None:
    body = batch_of(*[[0.5, 0.25, 0.125]] * 500) | {"k" * 100_000: "x" * 100_000}
    for sample in body["samples"]:
        sample["sequence"] = "y" * 500
    response = bench.post(body)
    assert (response.status_code, len(response.json()["errors"])) == (422, 10)
    assert "more)" in response.json()["detail"]
    assert len(response.content) < 4000


@pytest.mark.promise("docs/reference/metrics.md", "Batches that changed nothing.")
def test_missing_channels_are_named_and_the_batch_changes_nothing(bench: Bench) -> None:
    response = bench.post(batch_of([0.5, 0.25], channels=["s1", "spare"]))
    assert (response.status_code, kind(response)) == (422, "missing-channels")
    assert response.json()["missing_channels"] == ["s2", "s3"]
    assert (accepted(bench), bench.problem()) == (0, "no-samples")


DETAIL = (
    "The samples are of beam beam-2, the model is of beam beam-1. Give the service the model of beam-2, or the daemon "
    "the configuration that was built with this model (a beam of 400 mm; s1 100, s2 200, s3 300)."
)


@pytest.mark.promise("docs/reference/samples.md", "A service whose model is of another beam refuses the batch.")
@pytest.mark.promise(
    "docs/how-to/upgrade.md",
    "Until both are of the same beam, the service refuses the samples (`other-beam`)",
)
def test_samples_of_another_beam_are_refused_and_every_answer_says_so(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    for sequence in (1, 2):
        refused = bench.post(batch_of(sequence=sequence) | {"beam": "beam-2"})
        assert (refused.status_code, kind(refused)) == (503, "other-beam")
    contact = bench.get("/contact").json()
    assert (contact["type"], contact["detail"]) == ("urn:beamtouch:problem:other-beam", DETAIL)
    assert (contact["sender_beam"], contact["model_beam"]) == ("beam-2", "beam-1")
    assert bench.get("/health/ready").json()["surfaces"]["press-7"] == contact
    summary = bench.get("/surfaces/press-7").json()
    assert (summary["beam"], summary["state"], summary["problem"]) == ("beam-1", None, contact)
    assert [one.getMessage() for one in caplog.records] == [f"surface press-7: its samples are refused: {DETAIL}"]
    bench.now_s += 9
    assert bench.problem() == "other-beam"  # a daemon that is refused asks again within seconds
    bench.now_s += 2
    assert bench.problem() == "no-samples"


@pytest.mark.promise("docs/reference/samples.md", "Null: the sender does not say, and nothing is compared.")
def test_samples_of_the_beam_of_the_model_or_of_none_are_taken_and_a_former_beam_changes_nothing(bench: Bench) -> None:
    bench.post(batch_of(boot_id="boot-0002") | {"beam": "beam-2"})
    bench.send(members={"beam": "beam-1"})
    bench.send(sequence=2)
    assert bench.contact()["state"] == "contact"
    late = bench.post(batch_of(boot_id="boot-0000", age_ms=60_000) | {"beam": "beam-2"})
    assert (kind(late), bench.contact()["state"]) == ("other-beam", "contact")
    bench.now_s += 1
    assert bench.problem() == "stale"


@pytest.fixture
def description(bench: Bench) -> dict[str, Any]:
    content: dict[str, Any] = bench.get("/openapi.json").json()
    return content


def test_the_description_says_that_a_batch_of_samples_is_required(description: dict[str, Any]) -> None:
    body = description["paths"]["/surfaces/{name}/samples"]["post"]["requestBody"]
    batch = {"application/json": {"schema": {"$ref": "#/components/schemas/Batch"}}}
    assert body == {"required": True, "content": batch}
    assert "samples" in description["components"]["schemas"]["Batch"]["required"]


def test_the_description_describes_every_operation_and_its_problems(description: dict[str, Any]) -> None:
    operations = [one for each in description["paths"].values() for one in each.values()]
    for operation in operations:
        assert operation["description"]
        assert len(operation["tags"]) == 1
        assert set(operation["responses"]) == {"200", "default"}
        problem = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
        assert operation["responses"]["default"]["content"] == problem


def test_the_description_is_whole_and_its_example_is_a_batch(description: dict[str, Any]) -> None:
    schemas = description["components"]["schemas"]
    references = {part.split('"')[0] for part in json.dumps(description).split('"#/components/schemas/')[1:]}
    assert references <= set(schemas)
    assert "HTTPValidationError" not in schemas
    (example,) = schemas["Batch"]["examples"]
    assert Batch.model_validate_json(json.dumps(example)).boot_id == "6f1d2c84-0b7e-4a53"


@pytest.mark.parametrize(
    ("outputs", "kind_of", "row"),
    [(PLATE_OUTPUTS, "Plate", [0.5, 0.25, 0.125, 0.0]), (POSITION_OUTPUTS + FORCE_OUTPUTS, "", TOUCHING)],
)
def test_the_description_has_the_answers_of_beams_and_plates(
    description: dict[str, Any], outputs: tuple[str, ...], kind_of: str, row: Row
) -> None:
    bench = Bench(surface_of(outputs=outputs, channels=len(row)))
    bench.send([0.0] * len(row), *[row] * 4, [0.0] * len(row))
    bench.send(*[row] * 4, sequence=7, begin_us=START_US + 50_000)
    (event, *_) = bench.get("/events?kind=contact").json()["events"]
    whole = bench.get(f"/events/{event['id']}").json()
    answers = {"Contact": bench.contact(), "Event": event, "EventWithPath": whole, "Stay": whole["path"][0]}
    for name, answer in answers.items():
        schema = {"$ref": f"#/components/schemas/{kind_of}{name}", "components": description["components"]}
        jsonschema.Draft202012Validator(schema).validate(answer)
        members = description["components"]["schemas"][f"{kind_of}{name}"]["properties"]
        assert [member for member in answer if member not in members] == []


def test_the_messages_in_the_document_of_mqtt_have_the_members_of_today() -> None:
    messages = [shown_in(line[line.index("{") :]) for line in MQTT.read_text().splitlines() if line.endswith("}")]
    (contact,) = [message for message in messages if "state" in message]
    (event,) = [message for message in messages if "touched_at" in message]
    for message, kind_of in ((contact, Contact), (event, EventAnswer)):
        assert is_part_of(message, kind_of.model_fields)
    Contact.model_validate(example_of(fields_of()) | contact)
