"""How the page is served: types, caching, and nothing from elsewhere."""

import re
from importlib import resources

import pytest

from beamtouch_service.samples import Note
from service.bench import Bench
from support.pages.tags import Tags

PAGE = resources.files("beamtouch_service") / "page"
FILES = sorted(entry.name for entry in PAGE.iterdir())
TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}


def path_of(name: str) -> str:
    return "/" if name == "index.html" else f"/{name}"


@pytest.mark.parametrize("name", FILES)
def test_each_file_is_served_with_its_type_and_asked_for_again(bench: Bench, name: str) -> None:
    path = path_of(name)
    answer = bench.get(path)
    assert (answer.status_code, answer.content) == (200, (PAGE / name).read_bytes())
    assert answer.headers["content-type"].partition(";")[0] == TYPES[name.rpartition(".")[2]]
    assert answer.headers["content-security-policy"].startswith("default-src 'self';")
    assert "unsafe" not in answer.headers["content-security-policy"]
    assert answer.headers["cache-control"] == "no-cache"
    tag = answer.headers["etag"]
    again = bench.client.get(path, headers={"If-None-Match": f'"other", W/{tag}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert bench.client.get(path, headers={"If-None-Match": '"other"'}).status_code == 200
    head = bench.client.head(path)
    assert (head.status_code, head.content) == (200, b"")


def test_no_file_of_the_page_is_a_route_that_is_described(bench: Bench) -> None:
    described = bench.get("/openapi.json").json()["paths"]
    assert "/contact" in described
    assert not set(map(path_of, FILES)) & set(described)


@pytest.mark.promise("docs/reference/page.md", "Its content security policy lets it load from the service only.")
def test_nothing_comes_from_elsewhere_and_nothing_is_inline(bench: Bench) -> None:
    tags = Tags(bench.get("/").text)
    assert tags.of("html")[0]["lang"] == "en"
    for _, attributes in tags.found:
        assert not {name for name in attributes if name == "style" or name.startswith("on")}
        for name in ("src", "href"):
            # From the page on: a proxy may have it below a path of its own.
            assert re.fullmatch(r"[a-z_.]*", attributes.get(name) or "")
    assert all("src" in script for script in tags.of("script"))
    assert tags.of("style") == []
    scripts = "".join((PAGE / name).read_text() for name in FILES if name.endswith((".js", ".css")))
    assert "https:" not in scripts
    assert "innerHTML" not in scripts
    assert scripts.count("http:") == 1, "the name of SVG, and nothing else"


def test_the_page_has_words_for_every_note() -> None:
    words = (PAGE / "notes.js").read_text()
    assert [note for note in Note if f"\n  {note}: " not in words] == []
