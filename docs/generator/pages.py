"""Generated parts of pages: a line `<!-- generate: NAME -->` in a page stands for one of them.

Text from there to a line `<!-- generated -->` is for those who read the file and not the site.
"""

import re
from collections.abc import Callable, Mapping
from functools import cache, partial

from pydantic import BaseModel

import facts
from beamtouch_daemon.config.settings import Config
from beamtouch_models.rig.imperfections import Imperfections
from beamtouch_models.rig.script import Script
from beamtouch_models.scene import Scene
from beamtouch_service.config_sections import ConfigFile
from beamtouch_service.problems import ProblemBody
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.contact import Contact
from helps import helps_as_markdown
from project import ROOT
from schemas import Schema, editor_schema, keys_as_markdown

FILES: dict[str, tuple[type[BaseModel], str]] = {
    "scene": (Scene, "Scene of Beamtouch"),
    "daemon": (Config, "Configuration of beamtouch-daemon"),
    "service": (ConfigFile, "Configuration of beamtouch-service"),
    "rig-script": (Script, "Script of beamtouch-rig"),
    "rig-imperfections": (Imperfections, "Imperfections of beamtouch-rig"),
}
"""Files that people write, by the name of their schema."""
ANSWERS: dict[str, type[BaseModel]] = {"contact": Contact, "problem": ProblemBody, "batch": Batch}
"""What programs send and receive as JSON."""
SHOWN = {
    "docs/index.md": "README.md",
    "docs/changelog.md": "CHANGELOG.md",
    "docs/contributing.md": "CONTRIBUTING.md",
    "docs/how-to/several-services.md": "deploy/README.md",
    "docs/reference/daemon.md": "daemon/README.md",
    "docs/reference/device.md": "firmware_protocol/README.md",
    "docs/reference/protocol.md": "firmware_protocol/PROTOCOL.md",
    "docs/reference/service.md": "service/README.md",
}
"""Pages that show a file from outside `docs/`, by their path."""
PAGES = {file: page for page, file in SHOWN.items()}
_MARK = re.compile(r"<!-- generate: ([a-z-]+) -->(?:(?:(?!<!--).)*<!-- generated -->)?", re.DOTALL)
_SCRIPT = re.compile(r"<!-- script: (\S+) -->")


def schema(name: str, site: str) -> Schema:
    """Return the JSON Schema of one of `FILES`; `site` is the address of the site."""
    model, title = FILES[name]
    return editor_schema(model, title, f"{site}schemas/{name}.json")


@cache
def generated(name: str) -> str:
    """Return the Markdown of a generated part."""
    return _PARTS[name]()


def _keys_of_file(name: str) -> str:
    return keys_as_markdown(schema(name, ""), 3 if name.startswith("rig") else 2)


def _keys_of_answer(name: str) -> str:
    found = ANSWERS[name].model_json_schema()
    return keys_as_markdown(found | {"title": name}, 3)


_PARTS: Mapping[str, Callable[[], str]] = (
    {f"keys-{name}": partial(_keys_of_file, name) for name in FILES}
    | {f"members-{name}": partial(_keys_of_answer, name) for name in ANSWERS}
    | {"commands": helps_as_markdown, "metrics": facts.metrics, "problems": facts.problems}
)


def filled(text: str) -> str:
    """Return the Markdown of a page with its generated parts, and with the scripts that it shows."""
    shown = _SCRIPT.sub(lambda match: f"```python\n{(ROOT / match[1]).read_text().strip()}\n```", text)
    return _MARK.sub(lambda match: generated(match[1]), shown)
