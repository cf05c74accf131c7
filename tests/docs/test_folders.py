"""The lists of folders in CONTRIBUTING.md: every folder with code has its line, and every line its folder."""

import re

import pytest

from pasted import ROOT

PACKAGES = {
    "daemon": "daemon/beamtouch_daemon",
    "service": "service/beamtouch_service",
    "models": "models/beamtouch_models",
}


@pytest.mark.parametrize("name", PACKAGES)
def test_every_folder_of_a_package_has_a_line_and_every_line_a_folder(name: str) -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = text.split(f"### `{name}/`")[1].split("\n### ")[0]
    package = ROOT / PACKAGES[name]
    folders = {str(path.parent.relative_to(package)) for path in package.rglob("*.py")}
    listed = {folder.rstrip("/") for folder in re.findall(r"^\| `([^`]+)` \|", section, re.MULTILINE)}
    assert folders <= listed
    assert all((package / folder).is_dir() for folder in listed)
