"""The contact as bytes is the contact of the surface."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
from prometheus_client import Counter

from beamtouch_service.api.encoded import EncodedContacts
from beamtouch_service.problems import Kind, ProblemError

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch

ROWS = [[0.5, 0.25, 0.125], [0.0, 0.0, 0.0], [0.5, 0.25, None], [0.01, 0.3, 0.07]]


@pytest.fixture
def contacts() -> EncodedContacts:
    return EncodedContacts(Counter("contacts", "Contacts.", ["surface", "state"], registry=None))


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize("age_s", [0.0, 0.00004, 0.0123, 0.33333, 0.5])
def test_bytes_say_what_the_surface_says(
    bench: Bench, contacts: EncodedContacts, make_batch: MakeBatch, row: list[float | None], age_s: float
) -> None:
    bench.post(make_batch(row, quality=["good" if value is not None else "missing" for value in row]))
    surface = bench.app.context.registry.named("press-7")
    contacts.get(surface, bench.now_s)

    found = contacts.get(surface, bench.now_s + age_s)
    assert found.decode() == surface.contact(bench.now_s + age_s).model_dump_json()


def test_every_new_sample_is_encoded_anew_and_none_is_served_late(
    bench: Bench, contacts: EncodedContacts, make_batch: MakeBatch
) -> None:
    surface = bench.app.context.registry.named("press-7")
    with pytest.raises(ProblemError) as none:
        contacts.get(surface, bench.now_s)
    assert none.value.problem.kind is Kind.NO_SAMPLES
    for number, row in enumerate(ROWS[:2], start=1):
        bench.post(make_batch(row, sequence=number))
        assert json.loads(contacts.get(surface, bench.now_s))["sequence"] == number

    contacts.get(surface, bench.now_s + 0.5)
    with pytest.raises(ProblemError) as late:
        contacts.get(surface, bench.now_s + 0.5000001)
    assert late.value.problem.kind is Kind.STALE


@pytest.mark.parametrize(
    "path",
    ["/contact", "/contact?surface=press-7", "/contact?x=1&surface=%70ress-7&x", "/surfaces/press-7/contact"],
)
def test_every_way_to_ask_gives_the_contact_of_the_surface(bench: Bench, make_batch: MakeBatch, path: str) -> None:
    bench.post(make_batch())
    answer = bench.get(path)

    assert answer.json() == bench.app.context.registry.named("press-7").contact(bench.now_s).model_dump(mode="json")
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers["content-type"] == "application/json"


def test_an_empty_name_is_no_surface(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch())

    assert bench.get("/contact?surface=").status_code == 404
