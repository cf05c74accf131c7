"""Paths in documents: docs/reference/house.md lists every folder and no others, and links lead to files."""

import re

import pytest

from support.pages.pasted import ROOT

PACKAGES = {
    "daemon": "daemon/beamtouch_daemon",
    "service": "service/beamtouch_service",
    "models": "models/beamtouch_models",
}
MADE = {"build", "dist"}
"""Folders that builds make."""
FOLDERS = [path for path in ROOT.glob("[!.]*/") if path.is_dir() and path.name not in MADE]
HOUSE = (ROOT / "docs" / "reference" / "house.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", PACKAGES)
def test_every_folder_of_a_package_has_a_line_and_every_line_a_folder(name: str) -> None:
    section = HOUSE.split(f"## `{name}/`")[1].split("\n## ")[0]
    package = ROOT / PACKAGES[name]
    folders = {str(path.parent.relative_to(package)) for path in package.rglob("*.py")}
    listed = {folder.rstrip("/") for folder in re.findall(r"^\| `([^`]+)` \|", section, re.MULTILINE)}
    assert sorted(folders - listed) == []
    assert [folder for folder in sorted(listed) if not (package / folder).is_dir()] == []


def test_every_folder_at_the_top_has_a_heading() -> None:
    headings = "".join(re.findall(r"^## .*", HOUSE, re.MULTILINE))
    assert len(FOLDERS) > 5
    assert [folder.name for folder in FOLDERS if f"`{folder.name}/`" not in headings] == []


def test_the_method_is_an_afternoon_of_reading() -> None:
    section = HOUSE.split("## The method, in the order in which to read it")[1]
    (limit,) = re.findall(r"Under (\d+) lines", section)
    files = [ROOT / PACKAGES["models"] / name for name in re.findall(r"`([\w/]+\.py)`", section)]
    assert len(files) > 10
    assert sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files) < int(limit)


def test_the_way_of_a_sample_is_an_afternoon_of_reading() -> None:
    section = HOUSE.split("## The way of a sample, in the order in which to read it")[1].split("\n## ")[0]
    ((limit, number),) = re.findall(r"under (\d+) lines in (\d+) files", section)
    files = {ROOT / name for name in re.findall(r"`([\w/]+\.py)`", section)}
    assert len(files) == int(number)
    assert sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files) < int(limit)


def test_every_link_to_a_file_leads_to_one_in_a_checkout() -> None:
    """A forge shows the files themselves; the site shows some of them as pages with other addresses."""
    broken, links = [], 0
    for file in [*ROOT.glob("*.md"), *(file for folder in FOLDERS for file in folder.rglob("*.md"))]:
        for target in re.findall(r"\]\(([^()\s#]+)", file.read_text(encoding="utf-8")):
            links += 1
            if ":" not in target and not (file.parent / target).exists():
                broken.append(f"{file.relative_to(ROOT)}: {target}")
    assert links > 100
    assert broken == []
