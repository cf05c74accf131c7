"""The token that each route needs, written by hand for each method: what the code says of itself is no witness."""

from collections.abc import Iterator

import pytest
from fastapi.routing import iter_route_contexts

from service.bench import ADMIN_TOKEN, READ_TOKEN, TOKEN, Bench, kind, surface_of

FILES = (
    *(
        "alarms",
        "answer",
        "beam",
        "beam_parts",
        "candidate",
        "commissioning",
        "curves",
        "dom",
        "drawing",
        "events",
        "feed",
        "fields",
        "figures",
        "german",
        "health",
    ),
    *("notes", "page", "places", "plate", "qualities", "say", "settings", "sse", "state", "static_words", "strip"),
    *("tables", "times", "token", "token_form", "zones"),
)
NEEDS = {
    "GET /": "nothing",
    **{f"GET /{name}.js": "nothing" for name in FILES},
    **{f"GET /{name}.css": "nothing" for name in ("commissioning", "page", "zones")},
    "GET /icon.svg": "nothing",
    "GET /health/live": "nothing",
    "GET /alarms": "read",
    "GET /health/ready": "read",
    "GET /metrics": "read",
    "GET /openapi.json": "read",
    "GET /contact": "read",
    "GET /stream": "read",
    "GET /audit": "admin",
    "GET /events": "read",
    "GET /events/{id}": "read",
    "GET /surfaces": "read",
    "GET /surfaces/{name}": "read",
    "GET /surfaces/{name}/beam": "read",
    "GET /surfaces/{name}/calibration-data": "read",
    "GET /surfaces/{name}/candidate": "read",
    "GET /surfaces/{name}/commissioning": "read",
    "GET /surfaces/{name}/commissionings": "read",
    "GET /surfaces/{name}/commissionings/{id}": "read",
    "GET /surfaces/{name}/contact": "read",
    "GET /surfaces/{name}/model": "read",
    "GET /surfaces/{name}/stream": "read",
    "POST /surfaces/{name}/commissioning": "admin",
    "POST /surfaces/{name}/commissioning/abandon": "admin",
    "POST /surfaces/{name}/commissioning/confirm": "admin",
    "POST /surfaces/{name}/commissioning/skip": "admin",
    "POST /surfaces/{name}/samples": "write",
}
"""Method and path of each route -> the least token that it takes. Each token also does what those before it do."""
WRITES = [route for route, needs in NEEDS.items() if needs in ("write", "admin")]
QUERY = "run=c&step=0&by=Ann"
"""What some routes need beside a token; others pass over it."""


def served(bench: Bench) -> Iterator[str]:
    for route in iter_route_contexts(bench.app.routes):
        # A route of GET answers HEAD: see `test_head_needs_the_token_of_get`.
        yield from (f"{method} {route.path}" for method in (route.methods or ()) if method != "HEAD")


def outcome(bench: Bench, method: str, path: str, token: str | None) -> str:
    """Ask; return `refused` (401), `forbidden` (403) or `passed`."""
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    answer = bench.client.request(method, f"{path.format(name='press-7', id=1)}?{QUERY}", headers=headers)
    assert answer.status_code != 405, (method, path)
    if answer.status_code in (401, 403) and method != "HEAD":
        assert kind(answer) == {401: "unauthorized", 403: "forbidden"}[answer.status_code]
    return {401: "refused", 403: "forbidden"}.get(answer.status_code, "passed")


def make_bench(token: str | None, read_token: str | None, admin_token: str | None = None) -> Bench:
    bench = Bench(surface_of(), token=token, read_token=read_token, admin_token=admin_token)
    bench.app.context.streams.stop()  # a stream ends at once then
    return bench


def test_the_table_names_every_route_and_every_method() -> None:
    routes = list(served(make_bench(TOKEN, READ_TOKEN)))
    assert sorted(routes) == sorted(NEEDS)


def ask(bench: Bench, *tokens: str | None) -> dict[str, list[str]]:
    """Ask every route with each token."""
    each = [(route, *route.split()) for route in NEEDS]
    return {route: [outcome(bench, method, path, token) for token in tokens] for route, method, path in each}


@pytest.mark.promise(
    "docs/reference/http.md",
    "The write token (`write_token_file`) can also read.",
    "the next step without a press; the result on record; the end without a result",
)
def test_each_route_takes_the_tokens_of_the_table_and_no_others() -> None:
    passed, refused = "passed", "refused"
    answers = {
        "nothing": [passed, passed, passed, passed],
        "read": [refused, refused, passed, passed],
        "write": [refused, refused, "forbidden", passed],
        "admin": [refused, refused, "forbidden", passed],
    }
    asked = ask(make_bench(TOKEN, READ_TOKEN), None, "wrong", READ_TOKEN, TOKEN)
    assert asked == {route: answers[needs] for route, needs in NEEDS.items()}


@pytest.mark.promise("docs/reference/http.md", "With one, the write token no longer administrates.")
def test_with_an_admin_token_the_write_token_does_not_administrate() -> None:
    passed, forbidden = "passed", "forbidden"
    answers = {
        "nothing": [passed, passed, passed],
        "read": [passed, passed, passed],
        "write": [forbidden, passed, passed],
        "admin": [forbidden, forbidden, passed],
    }
    asked = ask(make_bench(TOKEN, READ_TOKEN, ADMIN_TOKEN), READ_TOKEN, TOKEN, ADMIN_TOKEN)
    assert asked == {route: answers[needs] for route, needs in NEEDS.items()}


def test_an_admin_token_alone_writes_and_leaves_reading_open() -> None:
    asked = ask(make_bench(None, None, ADMIN_TOKEN), None, ADMIN_TOKEN)
    refused = {route: "refused" if needs in ("write", "admin") else "passed" for route, needs in NEEDS.items()}
    assert asked == {route: [without, "passed"] for route, without in refused.items()}


@pytest.mark.promise(
    "docs/reference/http.md",
    "Without a read token (`read_token_file`), everyone who reaches the service may read.",
)
@pytest.mark.promise("docs/reference/service-configuration.md", "Without it, reads need no token.")
def test_without_a_read_token_reads_are_open_and_writes_are_not() -> None:
    asked = ask(make_bench(TOKEN, None), None, "wrong", TOKEN)
    refused = {route: "refused" if needs in ("write", "admin") else "passed" for route, needs in NEEDS.items()}
    assert asked == {route: [without, without, "passed"] for route, without in refused.items()}


@pytest.mark.promise("docs/reference/http.md", "Without it, writes are disabled.")
@pytest.mark.promise("docs/reference/service-configuration.md", "Without it, every write is refused.")
@pytest.mark.parametrize("read_token", [None, READ_TOKEN])
def test_without_a_write_token_no_route_writes(read_token: str | None) -> None:
    asked = ask(make_bench(None, read_token), None, "None", TOKEN, READ_TOKEN)
    assert {route: set(asked[route]) for route in WRITES} == {route: {"refused"} for route in WRITES}


@pytest.mark.promise("docs/reference/http.md", "Every route that answers GET also answers HEAD, except the streams.")
def test_head_needs_the_token_of_get() -> None:
    bench = make_bench(TOKEN, READ_TOKEN)
    for route, needs in NEEDS.items():
        method, path = route.split()
        if method == "GET" and not path.endswith("/stream"):
            asked = [outcome(bench, "HEAD", path, token) for token in (None, READ_TOKEN)]
            with_token = "forbidden" if needs == "admin" else "passed"
            assert asked == ["passed" if needs == "nothing" else "refused", with_token], route
    for path in ("/stream", "/surfaces/press-7/stream"):
        answer = bench.client.head(path, headers={"Authorization": f"Bearer {READ_TOKEN}"})
        assert (answer.status_code, answer.headers["allow"]) == (405, "GET")


@pytest.mark.parametrize("method", ["GET", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"])
def test_a_method_that_a_route_does_not_have_is_refused_without_a_token(method: str) -> None:
    bench = make_bench(TOKEN, READ_TOKEN)
    for path in {route.split()[1] for route in NEEDS}:
        if f"{method} {path}" not in NEEDS:
            answer = bench.client.request(method, f"{path.format(name='press-7', id=1)}?{QUERY}")
            assert answer.status_code == 401, path
