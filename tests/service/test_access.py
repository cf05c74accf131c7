"""Which token opens what, and what every answer carries."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.access import Access
from beamtouch_service.surface import Surface
from service.conftest import ADMIN_TOKEN, READ_TOKEN, TOKEN

if TYPE_CHECKING:
    import httpx2

    from service.conftest import Bench, BuildModel, MakeBatch

ALL = Access(write=TOKEN, read=READ_TOKEN, admin=ADMIN_TOKEN)
READS = ["/contact", "/surfaces/press-7/contact", "/surfaces", "/surfaces/press-7", "/health/ready", "/metrics"]
READS += ["/surfaces/press-7/model", "/openapi.json", "/nothing"]


def kind(response: httpx2.Response) -> str:
    assert response.headers["content-type"] == "application/problem+json"
    return str(response.json()["type"]).removeprefix("urn:beamtouch:problem:")


@pytest.fixture
def guarded(make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch) -> Bench:
    bench = make_bench(Surface("press-7", modelfile.load(build_model())), token=ALL)
    assert bench.post(make_batch()).status_code == 200
    return bench


@pytest.mark.parametrize("path", READS)
def test_reading_takes_the_read_token_or_one_that_can_do_more(guarded: Bench, path: str) -> None:
    for token in (None, "wrong", READ_TOKEN[:-1], READ_TOKEN + "x"):
        response = guarded.get(path, token=token)
        assert (response.status_code, kind(response)) == (401, "unauthorized")
        assert response.headers["www-authenticate"].startswith("Bearer")
    answers = {guarded.get(path, token=token).status_code for token in (READ_TOKEN, TOKEN, ADMIN_TOKEN)}
    assert answers == {404 if path == "/nothing" else 200}


def test_health_is_open(guarded: Bench) -> None:
    assert guarded.get("/health/live").status_code == 200


@pytest.mark.parametrize("token", [READ_TOKEN, ADMIN_TOKEN])
def test_a_token_for_something_else_does_not_write(guarded: Bench, make_batch: MakeBatch, token: str) -> None:
    response = guarded.post(make_batch(sequence=2), token=token)

    assert (response.status_code, kind(response)) == (403, "forbidden")
    assert guarded.get("/surfaces/press-7", token=READ_TOKEN).json()["samples"]["accepted"] == 1


@pytest.mark.parametrize("token", [READ_TOKEN, TOKEN])
def test_a_token_for_something_else_does_not_administrate(guarded: Bench, token: str) -> None:
    response = guarded.post(b"", path="/surfaces/press-7/model/reload", token=token)

    assert (response.status_code, kind(response)) == (403, "forbidden")


def test_without_an_admin_token_nobody_administrates(bench: Bench) -> None:
    response = bench.post(b"", path="/surfaces/press-7/model/reload")

    assert (response.status_code, kind(response)) == (401, "unauthorized")
    assert "--admin-token-file" in response.json()["detail"]


@pytest.mark.parametrize("path", [*READS, "/health/live"])
def test_every_answer_tells_the_browser_to_be_careful(guarded: Bench, path: str) -> None:
    for token in (None, READ_TOKEN):
        headers = guarded.get(path, token=token).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert "default-src 'self'" in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["referrer-policy"] == "no-referrer"


def test_refusals_are_counted_and_logged_once_a_minute_without_the_token(
    guarded: Bench, make_batch: MakeBatch, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(5):
        guarded.get("/contact", token="a-secret-that-is-wrong")  # noqa: S106  # of this test only
        guarded.post(make_batch(), token=READ_TOKEN)

    assert [record.getMessage() for record in caplog.records if record.name == "beamtouch.service"] == [
        "refused (unauthorized): 1 since the last such line, the newest from testclient",
        "refused (forbidden): 1 since the last such line, the newest from testclient",
    ]
    text = guarded.get("/metrics", token=READ_TOKEN).text
    assert 'beamtouch_refusals_total{kind="unauthorized"} 5.0' in text
    assert 'beamtouch_refusals_total{kind="forbidden"} 5.0' in text


def test_tokens_are_not_printed() -> None:
    assert "horse" not in repr(ALL)
