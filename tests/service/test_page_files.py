"""How the page is served: types, caching, and headers that keep a browser to the service."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING

import pytest

from beamtouch_service.samples import Note
from tags import Tags

if TYPE_CHECKING:
    from service.conftest import Bench

FILES = sorted(entry.name for entry in (resources.files("beamtouch_service") / "page").iterdir())


@pytest.mark.parametrize(
    ("path", "media_type"),
    [
        ("/", "text/html; charset=utf-8"),
        ("/page.css", "text/css; charset=utf-8"),
        ("/page.js", "text/javascript; charset=utf-8"),
        ("/icon.svg", "image/svg+xml"),
    ],
)
def test_each_file_has_its_type_and_the_headers(bench: Bench, path: str, media_type: str) -> None:
    answer = bench.get(path)
    assert answer.status_code == 200
    assert answer.headers["content-type"] == media_type
    assert answer.headers["content-security-policy"].startswith("default-src 'self';")
    assert "unsafe" not in answer.headers["content-security-policy"]
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["cache-control"] == "no-cache"


def test_every_file_is_served(bench: Bench) -> None:
    for name in FILES:
        path = "/" if name == "index.html" else f"/{name}"
        assert bench.get(path).content == (resources.files("beamtouch_service") / "page" / name).read_bytes()


def test_what_a_browser_has_is_not_sent_again(bench: Bench) -> None:
    tag = bench.get("/page.js").headers["etag"]
    again = bench.client.get("/page.js", headers={"If-None-Match": f'"other", W/{tag}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert bench.client.get("/page.js", headers={"If-None-Match": '"other"'}).status_code == 200


def test_the_page_can_be_asked_for_its_head_only(bench: Bench) -> None:
    answer = bench.client.head("/")
    assert (answer.status_code, answer.content) == (200, b"")
    assert bench.client.post("/").status_code == 405


def test_nothing_comes_from_elsewhere_and_nothing_is_inline(bench: Bench) -> None:
    tags = Tags(bench.get("/").text)
    assert tags.of("html")[0]["lang"] == "en"
    for _, attributes in tags.found:
        assert not {name for name in attributes if name == "style" or name.startswith("on")}
        for name in ("src", "href"):
            assert attributes.get(name, "/").startswith("/")
    assert all("src" in script for script in tags.of("script"))
    assert tags.of("style") == []
    scripts = "".join(bench.get(f"/{name}").text for name in FILES if name.endswith((".js", ".css")))
    assert "https:" not in scripts
    assert "innerHTML" not in scripts
    assert scripts.count("http:") == 1, "the name of SVG, and nothing else"


def test_the_page_is_no_part_of_the_interface_for_programs(bench: Bench) -> None:
    assert not {"/", "/page.js"} & set(bench.get("/openapi.json").json()["paths"])


def test_the_page_has_words_for_every_note() -> None:
    words = (resources.files("beamtouch_service") / "page" / "notes.js").read_text()
    assert [note for note in Note if f"\n  {note}: " not in words] == []
