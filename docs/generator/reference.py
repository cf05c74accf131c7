"""Parts of the pages that come from code and tests: `make reference` writes them into the committed pages.

A part stands in its page between the lines `<!-- generate: NAME -->` and `<!-- generated -->`.
"""

import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from textwrap import fill

from pydantic import BaseModel

import facts
import promises
from beamtouch_daemon.config.settings import Config
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.schema import editor_schema
from beamtouch_models.lab.rig.loads import Script
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_service.config import ConfigFile
from beamtouch_service.fields import example_of
from beamtouch_service.problems import ProblemBody
from beamtouch_service.record import EventWithPath, PlateEventWithPath
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.fields import Contact, PlateContact, fields_of
from helps import helps_as_markdown, registers
from page_fields import page_fields
from project import ROOT
from schemas import keys_as_markdown, members_beside
from stubs import python_interface

FILES: dict[str, tuple[type[BaseModel], str]] = {
    "scene": (Scene, "Scene of Beamtouch"),
    "daemon": (Config, "Configuration of beamtouch-daemon"),
    "service": (ConfigFile, "Configuration of beamtouch-service"),
    "rig-script": (Script, "Script of beamtouch-rig"),
    "rig-imperfections": (Imperfections, "Imperfections of beamtouch-rig"),
}
"""Files that people write, by the name of their schema."""
ANSWERS: dict[str, type[BaseModel]] = {
    "contact": Contact,
    "event": EventWithPath,
    "problem": ProblemBody,
    "batch": Batch,
}
"""What programs send and receive as JSON."""
ON_PLATES: dict[str, type[BaseModel]] = {"contact": PlateContact, "event": PlateEventWithPath}
"""The answers whose members are named after the axes of the surface."""
PAGE_COLUMNS = 119
"""Longest line of an answer in a page."""
DOCS = ROOT / "docs"
SCHEMAS = DOCS / "schemas"
PAGE_FIELDS = ROOT / "service" / "beamtouch_service" / "page" / "fields.js"
_PART = re.compile(r"(<!-- generate: (\S+) -->\n).*?(<!-- generated -->)", re.DOTALL)


def reference() -> dict[Path, str]:
    """Return the text of each page with parts from the code, of each schema, and of a file of the page, by its path."""
    pages = {path: path.read_text() for path in sorted(DOCS.rglob("*.md"))}
    schemas = {name: editor_schema(*FILES[name]) for name in FILES} | {"openapi": facts.openapi()}
    return (
        {path: _filled(text) for path, text in pages.items() if _PART.search(text)}
        | {
            SCHEMAS / f"{name}.json": json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
            for name, schema in schemas.items()
        }
        | {PAGE_FIELDS: page_fields()}
    )


def _filled(page: str) -> str:
    return _PART.sub(lambda match: f"{match[1]}\n{_generated(match[2])}\n\n{match[3]}", page)


@cache
def _generated(name: str) -> str:
    return _script(name) if name.endswith(".py") else _PARTS[name]()


def _keys_of_file(name: str) -> str:
    return keys_as_markdown(editor_schema(*FILES[name]), 3 if name.startswith("rig") else 2)


def _keys_of_answer(name: str) -> str:
    schema = ANSWERS[name].model_json_schema() | {"title": name}
    whole = keys_as_markdown(schema, 3, f"The whole {name}")
    if name not in ON_PLATES:
        return whole
    on_plate = ON_PLATES[name].model_json_schema() | {"title": name}
    return f"{whole}\n\n{members_beside(on_plate, schema, 3, f'The {name} on a plate, in place of `position`')}"


def _example_of_contact() -> str:
    """Return an answer with the examples of the table, in lines that fit a page."""
    members = [
        f"{json.dumps(name)}:{json.dumps(value, separators=(',', ':'))}"
        for name, value in example_of(fields_of()).items()
    ]
    text = fill(f"{{{', '.join(members)}}}", PAGE_COLUMNS, break_long_words=False, break_on_hyphens=False)
    return "```json\n" + text.replace(", ", ",").replace("\n", "\n ") + "\n```"


def _script(name: str) -> str:
    return f"```python\n{(DOCS / name).read_text().strip()}\n```"


_PARTS: Mapping[str, Callable[[], str]] = (
    {f"keys-{name}": partial(_keys_of_file, name) for name in FILES}
    | {f"members-{name}": partial(_keys_of_answer, name) for name in ANSWERS}
    | {
        "commands": helps_as_markdown,
        "example-contact": _example_of_contact,
        "metrics": facts.metrics,
        "opcua-variables": facts.opcua_variables,
        "problems": facts.problems,
        "promises": promises.as_markdown,
        "python": python_interface,
        "registers": registers,
    }
)


def main() -> int:
    """Write each file whose text has changed, or with `--check` only name it; return the exit code."""
    os.environ.update(COLUMNS="96", NO_COLOR="1")  # helps as wide as the line of a page, and without colours
    files = {path: (text, path.read_text() if path.exists() else "") for path, text in reference().items()}
    # Each Python version breaks the lines of a help in its own way, so only words count.
    changed = {path: text for path, (text, old) in files.items() if text.split() != old.split()}
    names = [str(path.relative_to(ROOT)) for path in changed]
    if "--check" in sys.argv:
        if names:
            print(f"{', '.join(names)}: not as the code has it; type `make reference` and commit", file=sys.stderr)
        return 1 if names else 0
    for path, text in changed.items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    print(*(f"wrote {name}" for name in names), sep="\n", end="\n" if names else "")
    return 0


if __name__ == "__main__":
    sys.exit(main())
