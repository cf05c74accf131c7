"""Which token opens what, and what every answer carries."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.routing import iter_route_contexts

import beamtouch_service
from beamtouch_service.access import Access
from service.bench import ADMIN_TOKEN, READ_TOKEN, TOKEN, Bench, batch_of, kind, surface_of, surface_with

FOLDER = Path(beamtouch_service.__file__).with_name("page")
PAGE = {"/" if path.name == "index.html" else f"/{path.name}" for path in FOLDER.iterdir()}
NOT_TOKENS = [None, "wrong", READ_TOKEN[:-1], READ_TOKEN + "x", TOKEN[:-1], TOKEN + "x"]


@pytest.fixture
def guarded() -> Bench:
    bench = Bench(surface_of(), read_token=READ_TOKEN)
    bench.send()
    return bench


def routes(bench: Bench) -> Iterator[tuple[str, str]]:
    """Yield method and address of each route."""
    for path in sorted({str(route.path) for route in iter_route_contexts(bench.app.routes)}):
        yield "POST" if path.endswith("/samples") else "GET", path.format(name="press-7", id=1)


@pytest.mark.promise("docs/reference/http.md", "a live view of the contact; its files hold no data")
def test_no_route_is_open_but_the_page_and_the_check_that_the_process_answers(guarded: Bench) -> None:
    is_open = {path for method, path in routes(guarded) if guarded.client.request(method, path).status_code != 401}
    assert is_open == PAGE | {"/health/live"}
    assert {path for path in is_open if guarded.get(path).status_code == 200} == is_open
    in_address = [f"{path}?token={READ_TOKEN}" for path in ("/stream", "/surfaces/press-7/stream")]
    other = ["/nothing", "//", "/index.html", "/page", "/page.js/", "/page.js/contact", "/Page.js", "//page.js"]
    for path in (*other, *in_address):
        answer = guarded.client.get(f"http://testserver{path}")
        assert (answer.status_code, kind(answer)) == (401, "unauthorized"), path
    for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS"):
        assert guarded.client.request(method, "/page.js").status_code == 401, method
    for path in PAGE:
        assert not re.search("press-7|horse|s1|position_mm *: *[0-9]", guarded.get(path).text)


@pytest.mark.parametrize("token", NOT_TOKENS)
def test_nothing_but_the_whole_token_opens_a_route(guarded: Bench, token: str | None) -> None:
    for method, path in routes(guarded):
        if path not in PAGE | {"/health/live"}:
            headers = {"Authorization": f"Bearer {token}"} if token else {}
            answer = guarded.client.request(method, path, headers=headers)
            assert (answer.status_code, kind(answer)) == (401, "unauthorized"), path
            assert answer.headers["www-authenticate"].startswith("Bearer")
    assert guarded.get("/surfaces/press-7", token=TOKEN).json()["samples"]["accepted"] == 1


@pytest.mark.parametrize(("has_read_token", "has_admin_token"), [(False, False), (True, False), (True, True)])
def test_every_route_takes_the_tokens_that_its_description_names(has_read_token: bool, has_admin_token: bool) -> None:
    admin_token = ADMIN_TOKEN if has_admin_token else None
    read_token = READ_TOKEN if has_read_token else None
    bench = Bench(surface_with(None), read_token=read_token, admin_token=admin_token)
    description = bench.get("/openapi.json", token=TOKEN).json()
    tokens = {"read_token": READ_TOKEN, "write_token": TOKEN} if has_read_token else {"write_token": TOKEN}
    tokens |= {"admin_token": ADMIN_TOKEN} if has_admin_token else {}
    for path, operations in description["paths"].items():
        for method, operation in operations.items():
            if path.endswith("stream"):
                continue  # it would not end
            taken = {scheme for one in operation["security"] for scheme in one}
            is_open = not operation["security"] or {} in operation["security"]
            for name, token in {"": "", **tokens}.items():
                headers = {"Authorization": f"Bearer {token}"} if token else {}
                answer = bench.client.request(method, path.format(name="press-7", id=1), headers=headers)
                assert (answer.status_code not in (401, 403)) == (is_open or name in taken), (path, name)


@pytest.mark.parametrize(
    "header",
    [b"", b"Bearer", b"Basic correct-horse-battery-staple", b"Bearer \xff\xfe", b"correct-horse-battery-staple"],
)
def test_a_strange_authorization_is_refused(bench: Bench, header: bytes) -> None:
    response = bench.client.post("/surfaces/press-7/samples", content=b"{}", headers={b"Authorization": header})
    assert response.status_code == 401


def test_an_intruder_learns_no_name(guarded: Bench) -> None:
    nobody = [guarded.post(batch_of(), path="/surfaces/nobody/samples", token=token) for token in ("wrong", TOKEN)]
    assert [kind(answer) for answer in nobody] == ["unauthorized", "unknown-surface"]


def test_a_service_without_a_token_refuses_every_write_and_says_how_to_allow_it() -> None:
    response = Bench(surface_with(None), token=None).post(batch_of())
    assert response.status_code == 401
    assert "--write-token-file" in response.json()["detail"]


def test_every_answer_tells_the_browser_to_be_careful(guarded: Bench) -> None:
    for method, path in routes(guarded):
        for token in (None,) if path.endswith("stream") else (None, READ_TOKEN):
            headers = {"Authorization": f"Bearer {token}"} if token else {}
            found = guarded.client.request(method, path, headers=headers).headers
            assert found["x-content-type-options"] == "nosniff"
            assert "default-src 'self'" in found["content-security-policy"]
            assert "frame-ancestors 'none'" in found["content-security-policy"]
            assert found["referrer-policy"] == "no-referrer"


def test_refusals_are_counted_and_logged_once_a_minute_without_the_token(
    guarded: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(5):
        guarded.get("/contact", token="a-secret-that-is-wrong")  # noqa: S106  # of this test only
        guarded.post(batch_of(), token=READ_TOKEN)
    assert [record.getMessage() for record in caplog.records if record.name == "beamtouch_service.api.change_log"] == [
        "refused (unauthorized): 1 since the last such line, the newest from testclient",
        "refused (forbidden): 1 since the last such line, the newest from testclient",
    ]
    text = guarded.get("/metrics", token=READ_TOKEN).text
    assert 'beamtouch_refusals_total{kind="unauthorized"} 5.0' in text
    assert 'beamtouch_refusals_total{kind="forbidden"} 5.0' in text
    assert "horse" not in repr(Access.of(TOKEN, READ_TOKEN, ADMIN_TOKEN))
