"""Which token opens what, and what every answer carries."""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.access import Access
from beamtouch_service.surfaces.surface import Surface
from service.conftest import READ_TOKEN, TOKEN, kind

if TYPE_CHECKING:
    from service.conftest import Bench, BuildModel, MakeBatch

ALL = Access(write=TOKEN, read=READ_TOKEN)
PAGE = sorted(entry.name for entry in (resources.files("beamtouch_service") / "page").iterdir())
READS = ["/contact", "/surfaces/press-7/contact", "/surfaces", "/surfaces/press-7", "/health/ready", "/metrics"]
READS += [
    "/surfaces/press-7/model",
    "/openapi.json",
    "/nothing",
    "/events",
    "/events/1",
    "/events?surface=press-7&format=csv",
]
STREAMS = ["/stream", "/stream?surface=press-7", "/surfaces/press-7/stream"]


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
    answers = {guarded.get(path, token=token).status_code for token in (READ_TOKEN, TOKEN)}
    assert answers == {404 if path == "/nothing" else 200}


@pytest.mark.parametrize("path", STREAMS)
def test_a_stream_takes_the_token_in_its_header(guarded: Bench, path: str) -> None:
    for address in (path, f"{path}{'&' if '?' in path else '?'}token={READ_TOKEN}"):
        response = guarded.get(address)
        assert (response.status_code, kind(response)) == (401, "unauthorized")


OPEN = {"/health/live"} | {"/" if name == "index.html" else f"/{name}" for name in PAGE}


def test_health_and_the_files_of_the_page_are_open_and_nothing_else_is(guarded: Bench) -> None:
    assert {path for path in OPEN if guarded.get(path).status_code == 200} == OPEN
    assert {path for path in OPEN if guarded.client.head(path).status_code in {200, 405}} == OPEN
    described = guarded.get("/openapi.json", token=READ_TOKEN).json()["paths"]
    readable = {path for path, methods in described.items() if "get" in methods}
    assert len(readable) > 10
    named = {path.replace("{name}", "press-7") for path in readable - OPEN}
    assert {path: guarded.get(path).status_code for path in named} == dict.fromkeys(named, 401)


@pytest.mark.parametrize(
    "path",
    ["//", "/?/../contact", "/index.html", "/page", "/page/", "/page.js/", "/page.js/contact", "/Page.js", "//page.js"],
)
def test_what_only_looks_like_a_file_of_the_page_shows_nothing(guarded: Bench, path: str) -> None:
    answer = guarded.client.get(f"http://testserver{path}")
    if path.startswith("/?"):
        assert answer.text == guarded.get("/").text
    else:
        assert (answer.status_code, kind(answer)) == (401, "unauthorized")


def test_the_files_of_the_page_say_nothing_of_the_surface(guarded: Bench) -> None:
    for path in OPEN - {"/health/live"}:
        assert not re.search("press-7|horse|s1|position_mm *: *[0-9]", guarded.get(path).text)


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
@pytest.mark.parametrize("path", ["/", "/page.js"])
def test_the_files_of_the_page_are_open_for_reading_only(guarded: Bench, method: str, path: str) -> None:
    answer = guarded.client.request(method, path)
    assert (answer.status_code, kind(answer)) == (401, "unauthorized")


def test_the_read_token_does_not_write(guarded: Bench, make_batch: MakeBatch) -> None:
    response = guarded.post(make_batch(sequence=2), token=READ_TOKEN)

    assert (response.status_code, kind(response)) == (403, "forbidden")
    assert guarded.get("/surfaces/press-7", token=READ_TOKEN).json()["samples"]["accepted"] == 1


@pytest.mark.parametrize("path", [*READS, "/health/live", "/", "/page.js"])
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
