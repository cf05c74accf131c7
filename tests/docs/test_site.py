"""The site: complete, whole, and without requests to other hosts."""

import json
import re
import tomllib
from pathlib import Path
from urllib.parse import unquote, urlsplit

import jsonschema
import pytest
from pydantic import BaseModel

from beamtouch_service.problems import Kind
from helps import all_helps
from pasted import ROOT
from reference import ANSWERS, FILES
from schemas import editor_schema, keys_of

from .html_page import HtmlPage

pytestmark = pytest.mark.long
REFERENCE = {"scene": "scene", "daemon": "daemon-configuration", "service": "service-configuration"} | {
    "rig-script": "rig",
    "rig-imperfections": "rig",
    "contact": "contact",
    "problem": "problems",
    "batch": "samples",
}
"""Page of the reference, by what it describes."""
EXAMPLES = {
    "scene": sorted((ROOT / "models" / "scenes").glob("*.toml")),
    "daemon": [ROOT / "daemon" / "daemon.example.toml"],
    "service": [ROOT / "service" / "service.example.toml", ROOT / "deploy" / "service.toml"],
}


def pages_of(site: Path) -> dict[Path, HtmlPage]:
    return {path: HtmlPage(path) for path in site.rglob("*.html")}


def test_every_internal_link_leads_somewhere(site: Path) -> None:
    pages = pages_of(site)
    broken = []
    for path, page in pages.items():
        if path.name == "404.html":  # its links are absolute, as it stands in for any address
            continue
        for link in {*page.links, *page.loaded}:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            anchors = pages[target].anchors if target in pages else set()
            if not target.is_file() or (parts.fragment and unquote(parts.fragment) not in anchors):
                broken.append(f"{path.relative_to(site)}: {link}")

    assert len(pages) > 50
    assert broken == []


def test_no_page_loads_anything_from_another_host(site: Path) -> None:
    foreign = {(path.name, one) for path, page in pages_of(site).items() for one in page.loaded if urlsplit(one).netloc}

    assert foreign == set()


@pytest.mark.parametrize("name", REFERENCE)
def test_every_key_has_a_description_and_stands_on_the_site(site: Path, name: str) -> None:
    model: type[BaseModel] = FILES[name][0] if name in FILES else ANSWERS[name]
    keys = list(keys_of(editor_schema(model, name)))
    text = " ".join(HtmlPage(site / "reference" / REFERENCE[name] / "index.html").text.split())

    assert len(keys) > 4
    for table, key, value in keys:
        assert value.get("description"), f"{name}: {table}.{key} has no description"
        words = " ".join(value["description"].replace("`", "").split())
        assert key in text, f"{table}.{key} is missing on the site"
        assert words in text, f"the description of {table}.{key} is missing on the site"


def options_in(text: str) -> set[str]:
    """Return the options in a help text, in which a line may end at a hyphen."""
    return set(re.findall(r"--[a-z-]+[a-z]", re.sub(r"(?<=[a-z]-)\s+", "", text)))


def test_every_command_stands_on_the_site_with_its_help(site: Path) -> None:
    page = HtmlPage(site / "reference" / "commands" / "index.html")
    commands = dict(all_helps())

    assert len(commands) > 15
    for command, text in commands.items():
        assert f"usage: {command}" in page.text
        assert options_in(text) <= options_in(page.text), command


def test_every_problem_stands_on_the_site(site: Path) -> None:
    text = HtmlPage(site / "reference" / "problems" / "index.html").text

    assert all(kind.type_uri in text and kind.title in text for kind in Kind)


@pytest.mark.parametrize("name", FILES)
def test_the_schemas_are_on_the_site(site: Path, name: str) -> None:
    published = json.loads((site / "schemas" / f"{name}.json").read_text())

    jsonschema.Draft202012Validator.check_schema(published)
    assert "null" not in json.dumps(published)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_schemas_accept_the_shipped_examples_and_no_unknown_key(site: Path, name: str) -> None:
    validator = jsonschema.Draft202012Validator(json.loads((site / "schemas" / f"{name}.json").read_text()))

    for path in EXAMPLES[name]:
        example = tomllib.loads(path.read_text())
        validator.validate(example)
        assert not validator.is_valid(example | {"unheard_of": 1}), path
