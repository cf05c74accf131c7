"""The site is whole without other hosts, and its schemas fit the examples. `make check` compares its reference."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import jsonschema
import pytest
from pydantic import BaseModel

from beamtouch_models import cli
from beamtouch_models.design.scene.schema import editor_schema
from reference import ANSWERS, FILES
from schemas import keys_of
from support.pages.pasted import ROOT

SCHEMAS = ROOT / "docs" / "schemas"
EXAMPLES = {
    "scene": sorted((ROOT / "models" / "scenes").glob("*.toml")),
    "daemon": [ROOT / "daemon" / "daemon.example.toml"],
    "service": [ROOT / "service" / "service.example.toml", ROOT / "deploy" / "service.toml"],
}


@pytest.mark.long
def test_the_site_builds_without_a_warning_and_its_pages_load_nothing_from_other_hosts(tmp_path: Path) -> None:
    """A link or an anchor that leads nowhere is a warning; so is a page without a place in the navigation."""
    command: list[str | Path] = [Path(sys.prefix) / "bin" / "mkdocs", "build", "--quiet", "--strict"]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        [*command, "--site-dir", tmp_path], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) > 50
    tags = [
        tag for page in pages for tag in re.findall(r"<(?:script|img|iframe|source|link)\b[^>]*>", page.read_text())
    ]
    loading = [tag for tag in tags if not re.search('rel="?(canonical|next|prev|alternate)', tag)]
    assert len(loading) > 50
    assert [tag for tag in loading if re.search('(src|href)="?(\\w+:)?//', tag)] == []
    assert {f"{name}.json" for name in FILES} <= {path.name for path in (tmp_path / "schemas").iterdir()}


def test_a_command_prints_the_schema_of_a_scene_that_the_site_has(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["schema"]) == 0

    assert capsys.readouterr().out == (SCHEMAS / "scene.json").read_text()


@pytest.mark.parametrize("name", [*FILES, *ANSWERS])
def test_every_key_has_a_description(name: str) -> None:
    model: type[BaseModel] = FILES[name][0] if name in FILES else ANSWERS[name]
    keys = list(keys_of(editor_schema(model, name)))
    assert len(keys) > 4
    assert [f"{table}.{key}" for table, key, value in keys if not value.get("description")] == []


@pytest.mark.parametrize("name", FILES)
def test_the_schemas_accept_the_shipped_examples_and_no_unknown_key(name: str) -> None:
    schema = json.loads((SCHEMAS / f"{name}.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    assert "null" not in json.dumps(schema)
    for path in EXAMPLES.get(name, []):
        example = tomllib.loads(path.read_text())
        jsonschema.Draft202012Validator(schema).validate(example)
        assert not jsonschema.Draft202012Validator(schema).is_valid(example | {"unheard_of": 1}), path
