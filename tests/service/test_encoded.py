"""The contact as bytes is the contact as the routes give it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from beamtouch_service.api.encoded import EncodedContacts

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch

ROWS = [[0.5, 0.25, 0.125], [0.0, 0.0, 0.0], [0.5, 0.25, None], [0.01, 0.3, 0.07]]


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize("age_s", [0.0, 0.00004, 0.0123, 0.33333, 0.5])
def test_it_is_what_the_surface_says(
    bench: Bench, make_batch: MakeBatch, row: list[float | None], age_s: float
) -> None:
    quality = ["good" if value is not None else "missing" for value in row]
    bench.post(make_batch(row, quality=quality))
    registry = bench.app.context.registry
    contacts = EncodedContacts(registry)
    assert contacts.get(None, bench.now_s) is not None

    found = contacts.get("press-7", bench.now_s + age_s)
    assert found is not None
    contact = registry.named("press-7").contact(bench.now_s + age_s)
    assert (found[0], json.loads(found[1])) == (("press-7", contact.state.value), contact.model_dump(mode="json"))
    assert found[1].decode() == contact.model_dump_json()


def test_every_new_sample_is_encoded_anew_and_none_is_served_late(bench: Bench, make_batch: MakeBatch) -> None:
    contacts = EncodedContacts(bench.app.context.registry)
    assert contacts.get(None, bench.now_s) is None
    for number, row in enumerate(ROWS[:2]):
        bench.post(make_batch(row, sequence=number))
        found = contacts.get(None, bench.now_s)
        assert found is not None
        assert json.loads(found[1])["sequence"] == number

    assert contacts.get(None, bench.now_s + 0.5) is not None
    assert contacts.get(None, bench.now_s + 0.5000001) is None
    assert contacts.get("nobody", bench.now_s) is None


@pytest.mark.parametrize(
    "path", ["/contact", "/contact?surface=press-7", "/contact?x=1&surface=press-7", "/surfaces/press-7/contact"]
)
def test_every_way_to_ask_gives_the_same(bench: Bench, make_batch: MakeBatch, path: str) -> None:
    bench.post(make_batch())
    first, other = bench.get("/surfaces/press-7/contact"), bench.get(path)

    assert first.content == other.content
    assert dict(first.headers) == dict(other.headers)
    assert other.headers["cache-control"] == "no-store"
    assert other.headers["content-type"] == "application/json"


@pytest.mark.parametrize("path", ["/contact?surface=%70ress-7", "/contact?surface=", "/contact?surface=press-7&x"])
def test_an_unusual_way_to_ask_is_left_to_the_routes(bench: Bench, make_batch: MakeBatch, path: str) -> None:
    bench.post(make_batch())

    assert bench.get(path).status_code == (404 if path.endswith("=") else 200)
