"""What a write must bring: a token, a body of bounded size, and the right format."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_service.api.errors import pointer
from beamtouch_service.api.samples import MAX_BODY_BYTES
from beamtouch_service.samples import MAX_SAMPLES
from beamtouch_service.surfaces.surface import Surface
from service.conftest import kind

if TYPE_CHECKING:
    from collections.abc import Iterator

    from service.conftest import Bench, MakeBatch


def accepted(bench: Bench) -> int:
    return int(bench.get("/surfaces/press-7").json()["samples"]["accepted"])


def test_a_batch_holds_so_many_samples_and_no_more(bench: Bench, make_batch: MakeBatch) -> None:
    rows = [[0.5, 0.25, 0.125]] * MAX_SAMPLES
    response = bench.post(make_batch(*rows, [0.0, 0.0, 0.0]))

    assert (response.status_code, kind(response)) == (422, "invalid-request")
    assert response.json()["errors"][0]["pointer"] == "#/samples"
    assert accepted(bench) == 0
    assert bench.post(make_batch(*rows)).status_code == 200
    assert accepted(bench) == MAX_SAMPLES == 2000


@pytest.mark.parametrize("token", [None, "wrong", "correct-horse-battery-stapl", "correct-horse-battery-staple2"])
def test_a_write_without_the_token_changes_nothing(bench: Bench, make_batch: MakeBatch, token: str | None) -> None:
    response = bench.post(make_batch(), token=token)

    assert (response.status_code, kind(response)) == (401, "unauthorized")
    assert response.headers["www-authenticate"].startswith("Bearer")
    assert accepted(bench) == 0


@pytest.mark.parametrize(
    "header",
    [b"", b"Bearer", b"Basic correct-horse-battery-staple", b"Bearer \xff\xfe", b"correct-horse-battery-staple"],
)
def test_a_strange_authorization_is_refused_too(bench: Bench, header: bytes) -> None:
    response = bench.client.post("/surfaces/press-7/samples", content=b"{}", headers={b"Authorization": header})

    assert response.status_code == 401


def test_a_service_without_a_token_refuses_every_write_and_says_how_to_allow_it(
    make_bench: type[Bench], make_batch: MakeBatch
) -> None:
    response = make_bench(Surface("press-7"), token=None).post(make_batch())

    assert response.status_code == 401
    assert "--write-token-file" in response.json()["detail"]


def test_an_intruder_does_not_learn_which_surfaces_there_are(bench: Bench, make_batch: MakeBatch) -> None:
    response = bench.post(make_batch(), path="/surfaces/nobody/samples", token="wrong")  # noqa: S106  # it is wrong

    assert response.status_code == 401


def test_a_write_to_an_unknown_surface_is_404(bench: Bench, make_batch: MakeBatch) -> None:
    assert kind(bench.post(make_batch(), path="/surfaces/nobody/samples")) == "unknown-surface"


def test_a_body_that_states_to_be_too_large_is_refused(bench: Bench) -> None:
    response = bench.post(b" " * (MAX_BODY_BYTES + 1))

    assert (response.status_code, kind(response)) == (413, "too-large")


def test_a_body_that_grows_too_large_is_refused(bench: Bench) -> None:
    def chunks() -> Iterator[bytes]:
        for _ in range(MAX_BODY_BYTES // 65536 + 1):
            yield b" " * 65536

    response = bench.post(chunks())

    assert (response.status_code, kind(response)) == (413, "too-large")


@pytest.mark.parametrize("body", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b"not json"])
def test_what_is_not_json_is_malformed(bench: Bench, body: bytes) -> None:
    response = bench.post(body)

    assert (response.status_code, kind(response)) == (400, "malformed-json")
    assert len(response.content) < 1000


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"newest_age_ms": -1}, "#/newest_age_ms"),
        ({"newest_age_ms": "1"}, "#/newest_age_ms"),
        ({"newest_age_ms": float("nan")}, "#/newest_age_ms"),
        ({"newest_age_ms": float("inf")}, "#/newest_age_ms"),
        ({"boot_id": "short"}, "#/boot_id"),
        ({"channels": ["s1", "s1", "s1"]}, "#"),
        ({"channels": ["s1", "s2"]}, "#"),
        ({"surprise": 1}, "#/surprise"),
        ({"a/b~c": 1}, "#/a~1b~0c"),
    ],
)
def test_a_wrong_batch_is_refused_with_the_place_that_is_wrong(
    bench: Bench, make_batch: MakeBatch, change: dict[str, Any], place: str
) -> None:
    response = bench.post(json.dumps(make_batch() | change).encode())

    assert (response.status_code, kind(response)) == (422, "invalid-request")
    assert [error["pointer"] for error in response.json()["errors"]] == [place]
    assert accepted(bench) == 0


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_a_deflection_that_is_not_finite_is_refused(bench: Bench, make_batch: MakeBatch, value: str) -> None:
    text = json.dumps(make_batch([0.5, 0.25, 77.0])).replace("77.0", value)

    response = bench.post(text.encode())
    assert response.status_code == 422
    assert response.json()["errors"][0]["pointer"] == "#/samples/0/deflection_mm/2"


def test_a_hugely_wrong_batch_gets_a_short_answer(bench: Bench, make_batch: MakeBatch) -> None:
    body = make_batch(*[[0.5, 0.25, 0.125]] * 500) | {"k" * 100_000: "x" * 100_000}
    for sample in body["samples"]:
        sample["sequence"] = "y" * 500

    response = bench.post(body)
    assert response.status_code == 422
    assert len(response.json()["errors"]) == 10
    assert "more)" in response.json()["detail"]
    assert len(response.content) < 4000


def test_missing_channels_are_named(bench: Bench, make_batch: MakeBatch) -> None:
    response = bench.post(make_batch([0.5, 0.25], channels=["s1", "spare"]))

    assert (response.status_code, kind(response)) == (422, "missing-channels")
    assert response.json()["missing_channels"] == ["s2", "s3"]
    assert accepted(bench) == 0


def test_a_pointer_has_an_end() -> None:
    assert pointer(("samples", 3, "x")) == "#/samples/3/x"
    assert len(pointer(("k" * 10_000,))) == 200
