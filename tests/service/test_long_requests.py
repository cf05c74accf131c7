"""Long requests: other requests have their turn meanwhile, and nothing else changes for it."""

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from itertools import count
from typing import Any

import httpx2
import numpy as np
import pytest

from beamtouch_common.zones import Zone
from beamtouch_models.runtime.metadata import POSITION_OUTPUTS
from beamtouch_service import steps
from beamtouch_service.api.app import Application, create_app
from beamtouch_service.outputs.modbus.registers import registers_of
from beamtouch_service.samples import MAX_SAMPLES
from beamtouch_service.sections import SurfaceSection
from service.bench import START_US, TOKEN, Bench, Row, batch_of, surface_of
from service.event_story import ODD, RESTING, TOUCHING
from support.surfaces.small_model import model_of

pytestmark = pytest.mark.anyio
MANY = 200
LARGE = [[0.5, 0.25, 0.125]] * MANY
"""Rows of a batch that is read in steps."""


STEPS = 4
"""Steps of a slice."""


@pytest.fixture(autouse=True)
def _each_step_takes_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "perf_counter", count().__next__)
    monkeypatch.setattr(steps, "SLICE_S", STEPS)


@pytest.fixture
def app() -> Application:
    patient = SurfaceSection(stale_ms=60_000)
    return create_app([surface_of(section=patient), surface_of("press-8", patient)], TOKEN)


@pytest.fixture
async def client(app: Application) -> AsyncIterator[httpx2.AsyncClient]:
    headers = {"Authorization": f"Bearer {TOKEN}"}
    transport = httpx2.ASGITransport(app)
    async with httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1", headers=headers) as client:
        yield client
    await app.context.recorder.close()


async def turns_during(request: asyncio.Task[httpx2.Response]) -> int:
    """Return how often the event loop turns until a request is answered."""
    number = 0
    while not request.done():
        await asyncio.sleep(0)
        number += 1
    assert request.result().status_code == 200, request.result().text
    return number


async def turn_until(condition: Callable[[], bool]) -> None:
    """Let the event loop turn until a condition holds."""
    for _ in range(1_000_000):
        if condition():
            return
        await asyncio.sleep(0)
    raise AssertionError("it did not come true")


def wide(channels: int, samples: int) -> dict[str, Any]:
    """A batch of many channels, of which the model has three, with the covariances of all."""
    names = [f"s{number + 1}" for number in range(channels)]
    batch = batch_of(*[[0.01] * channels] * samples, channels=names)
    triangle = (np.eye(channels) * 1e-4)[np.tril_indices(channels)].tolist()
    for sample in batch["samples"]:
        sample |= {"readings": 1, "covariance_mm2": triangle}
    return batch


@pytest.mark.promise(
    "docs/reference/http.md",
    "The service takes in a large batch in steps, and answers others between them",
)
@pytest.mark.parametrize("batch", [batch_of(*LARGE), wide(64, 40)], ids=["many samples", "many channels"])
@pytest.mark.parametrize("backlog", [False, True])
async def test_the_loop_turns_between_the_samples_of_a_batch(
    client: httpx2.AsyncClient, batch: dict[str, Any], backlog: bool
) -> None:
    await client.post("/surfaces/press-7/samples", json=batch | {"samples": batch["samples"][:1]})
    members = {"backlog": True, "newest_age_ms": None} if backlog else {}
    post = client.post("/surfaces/press-7/samples", json=batch | members)
    # Each sample is a step while it is read, and another one when it moves the answer, or is taken into the record.
    assert await turns_during(asyncio.ensure_future(post)) > 1.5 * len(batch["samples"]) / STEPS


async def test_the_loop_turns_between_the_surfaces_of_the_metrics() -> None:
    bench = Bench(*[surface_of(f"press-{number}") for number in range(50)])
    async with httpx2.AsyncClient(transport=httpx2.ASGITransport(bench.app), base_url="http://127.0.0.1") as client:
        assert await turns_during(asyncio.ensure_future(client.get("/metrics"))) > 50 // STEPS


async def test_a_contact_is_answered_while_long_batches_are_taken(client: httpx2.AsyncClient) -> None:
    await client.post("/surfaces/press-8/samples", json=batch_of(TOUCHING))
    batch = batch_of(*LARGE, boot_id="boot-0002")
    long = [asyncio.ensure_future(client.post("/surfaces/press-7/samples", json=batch)) for _ in range(3)]
    await asyncio.sleep(0)
    answer = await client.get("/surfaces/press-8/contact")
    assert answer.json()["state"] == "contact"
    assert not any(post.done() for post in long)
    assert sorted([(await post).json()["repeated"] for post in long]) == [0, MANY, MANY]


async def test_a_batch_waits_for_the_one_before_it(client: httpx2.AsyncClient, app: Application) -> None:
    before = asyncio.ensure_future(client.post("/surfaces/press-7/samples", json=batch_of(*LARGE)))
    await turn_until(lambda: app.context.registry.named("press-7").counts.accepted > 0)
    assert not before.done()
    after = await client.post("/surfaces/press-7/samples", json=batch_of(RESTING, sequence=MANY + 1))
    assert ((await before).json()["accepted"], after.json()["accepted"]) == (MANY, 1)
    contact = (await client.get("/surfaces/press-7/contact")).json()
    assert contact["sequence"] == MANY + 1


async def test_what_is_shown_during_a_batch_is_of_one_sample() -> None:
    """Counts and alarms included: they are those of the sample whose number stands beside them."""
    section = SurfaceSection(
        stale_ms=60_000,
        zones={"gate": Zone(from_mm=120, to_mm=200)},
        unexplained_after_s=0.005,
        degraded_after_s=0.005,
    )
    app = create_app([surface_of(section=section)], TOKEN)
    surface = app.context.registry.named("press-7")

    async def summary() -> object:
        body = (await http.get("/surfaces/press-7")).json()
        return body["state"], body["channels_out"]

    async def metrics() -> object:
        families = ("beamtouch_zone_entries_total{", "beamtouch_unexplained", "beamtouch_channel_out{")
        return [line for line in (await http.get("/metrics")).text.splitlines() if line.startswith(families)]

    async def registers() -> object:
        view = surface.view(app.context.clock())
        found = {one.name: one.value(view) for one in registers_of(view.axes)}
        return found["sequence"], found["zone_1_entries"]

    async def fault() -> object:
        found = surface.find_fault(app.context.clock())
        return found and found.kind

    doors = [summary, metrics, registers, fault]
    odd = batch_of(*[TOUCHING] * MANY, *[ODD] * MANY, sequence=2)
    late_us = START_US + 2 * MANY * 5000
    out = batch_of(*[TOUCHING] * MANY, sequence=2 + 2 * MANY, quality=["good", "good", "stuck"], begin_us=late_us)
    transport = httpx2.ASGITransport(app)
    headers = {"Authorization": f"Bearer {TOKEN}"}
    async with httpx2.AsyncClient(transport=transport, base_url="http://127.0.0.1", headers=headers) as http:
        await http.post("/surfaces/press-7/samples", json=batch_of(RESTING))
        before = [await door() for door in doors]
        batch = odd | {"samples": odd["samples"] + out["samples"]}
        post = asyncio.ensure_future(http.post("/surfaces/press-7/samples", json=batch))
        await turn_until(lambda: surface.counts.accepted > 1)
        during = []
        while not post.done():
            during.append([await door() for door in doors])
        assert (await post).status_code == 200
        after = [await door() for door in doors]
    await app.context.recorder.close()
    assert all(now != then for now, then in zip(after, before, strict=True))
    assert before in during
    for now, *looks in zip(after, before, *during, strict=True):
        assert [one for one in looks[1:] if one not in (now, looks[0])] == []


async def test_a_model_that_changes_during_a_batch_does_not_mix_with_the_one_before(
    client: httpx2.AsyncClient, app: Application
) -> None:
    rows: list[Row] = [RESTING, *[TOUCHING] * MANY, RESTING]
    surface, new = app.context.registry.named("press-7"), model_of("new", outputs=POSITION_OUTPUTS)
    batch = batch_of(*rows) | {"oldest": 1}
    post = asyncio.ensure_future(client.post("/surfaces/press-7/samples", json=batch))
    await turn_until(lambda: surface.counts.accepted > 0)
    surface.adopt(new)
    await post
    receipt = post.result().json()
    while receipt["expected"] != len(rows) + 1:
        backlog = batch | {"backlog": True, "newest_age_ms": None}
        receipt = (await client.post("/surfaces/press-7/samples", json=backlog)).json()
    await app.context.recorder.flush()
    (event,) = (await client.get("/events?surface=press-7")).json()["events"]
    assert (event["model"], event["samples"], event["end"]) == (new.identity, MANY, "lift")
    assert event["peak_force_n"] is None  # the new model estimates none


def _set(*path: str | int, value: object) -> Callable[[dict[str, Any]], None]:
    """Return what sets a place of a batch."""

    def change(batch: dict[str, Any]) -> None:
        *way, last = path
        place: Any = batch
        for key in way:
            place = place[key]
        place[last] = value

    return change


WRONG: dict[str, Callable[[dict[str, Any]], None]] = {
    "a word for a number": _set("samples", 3, "deflection_mm", 1, value="x"),
    "an object for a list": _set("samples", 3, "quality", value={"s1": "good"}),
    "a list for a sample": _set("samples", 3, value=[1, 2]),
    "an unknown quality": _set("samples", 3, "quality", 0, value="fine"),
    "an unknown key of a sample": _set("samples", 3, "weight", value=1),
    "an unknown key": _set("weight", value=1),
    "many unknown keys": lambda batch: batch["samples"][3].update({f"key-{number}": 0 for number in range(15)}),
    "no boot": lambda batch: batch.pop("boot_id"),
    "a number for a boot": _set("boot_id", value=7),
    "an object for a list of channels": _set("channels", value={}),
    "no samples": lambda batch: batch.pop("samples"),
    "an object for a list of samples": _set("samples", value={"1": "2"}),
    "too many samples": lambda batch: batch["samples"].extend([{}] * MAX_SAMPLES),
    "numbers that do not increase": _set("samples", 3, "sequence", value=1),
    "another number of channels": _set("samples", 3, "deflection_mm", value=[0.1, 0.2]),
    "values without a channel": _set("channels", value=["s1", "s2"]),
    "a number that is none": _set("samples", 3, "deflection_mm", 1, value=float("nan")),
    "a sender and a sample": lambda batch: batch.update(boot_id="x", samples=[*batch["samples"], {}][-4:]),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
async def test_a_large_body_is_refused_with_the_words_for_a_small_one(
    client: httpx2.AsyncClient, wrong: Callable[[dict[str, Any]], None]
) -> None:
    answers = []
    for rows in (LARGE[:5], LARGE):
        batch = batch_of(*map(list, rows))  # each has its own
        wrong(batch)
        answer = await client.post("/surfaces/press-7/samples", content=json.dumps(batch))
        assert answer.status_code == 422
        answers.append(answer.json()["errors"])
    small, large = (
        json.dumps(answer).replace(f"not {MAX_SAMPLES + 5}", f"not {MAX_SAMPLES + MANY}") for answer in answers
    )
    assert small == large


@pytest.mark.parametrize("content", [b"[" + b"0, " * 9000 + b"0]", b" " * 9000 + b"7", b'"' + b"x" * 9000 + b'"'])
async def test_a_large_body_that_is_no_object_is_refused(client: httpx2.AsyncClient, content: bytes) -> None:
    answer = await client.post("/surfaces/press-7/samples", content=content)
    assert (answer.status_code, answer.json()["detail"]) == (422, "#: Input should be an object")


async def test_a_large_body_that_breaks_off_is_not_json(client: httpx2.AsyncClient) -> None:
    text = json.dumps(batch_of(*LARGE)).encode()
    small, large = [
        await client.post("/surfaces/press-7/samples", content=content) for content in (b'{"boot_id', text[:-2])
    ]
    for answer in (small, large):
        assert (answer.status_code, answer.json()["type"]) == (400, "urn:beamtouch:problem:malformed-json")
        assert answer.json()["detail"].startswith("Invalid JSON: EOF while parsing ")
        assert answer.json()["detail"].endswith("; send a batch as application/json.")


async def test_each_wrong_covariance_of_a_large_body_is_named(client: httpx2.AsyncClient) -> None:
    batch = wide(16, 300)
    for index, place, value in ((7, 0, -1.0), (150, 1, 1.0), (299, 1, 1.0)):
        triangle = list(batch["samples"][index]["covariance_mm2"])
        triangle[place] = value
        batch["samples"][index]["covariance_mm2"] = triangle
    batch["samples"][200]["deflection_mm"] = [None] * 16
    batch["samples"][200]["quality"] = ["missing"] * 16
    answer = (await client.post("/surfaces/press-7/samples", json=batch)).json()
    assert answer["detail"].endswith("has a negative value on its diagonal (and 3 more)")
    assert [(one["pointer"], one["detail"].partition("covariance_mm2 ")[2]) for one in answer["errors"]] == [
        ("#/samples/7", "has a negative value on its diagonal"),
        ("#/samples/150", "is not positive semi-definite"),
        ("#/samples/200", "must be 0 for a channel without a deflection"),
        ("#/samples/299", "is not positive semi-definite"),
    ]
