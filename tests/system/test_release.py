"""The distributions that `make release` has built: what they hold, and what an index would show of them."""

import re
import subprocess
import tarfile
import tomllib
from email import message_from_string
from email.message import Message
from pathlib import Path
from zipfile import ZipFile

import pytest

from links import absolute
from project import addresses
from support.running.debian_parts import give_up

ROOT = Path(__file__).parents[2]
BUILT = ROOT / "build" / "release"
PYPROJECT = (ROOT / "pyproject.toml").read_text()
PROJECT = tomllib.loads(PYPROJECT)["project"]


def newest(pattern: str) -> tuple[Path | None, str]:
    """Return the distribution that was built last, and why tests cannot use it; empty if they can."""
    found = sorted(BUILT.glob(pattern))
    if not found:
        return None, "the distributions are not built; type: make release"
    if found[-1].stat().st_mtime < max((ROOT / name).stat().st_mtime for name in ("pyproject.toml", "README.md")):
        return None, "the distributions are older than what they are made from; type: make release"
    return found[-1], ""


def built(pattern: str) -> Path:
    """Return a distribution; without it, skip the test."""
    path, reason = newest(pattern)
    if path is None:
        pytest.skip(reason)
    return path


def test_the_distributions_are_built() -> None:
    """This one fails for all others, which are skipped, where changes are decided."""
    _, reason = newest("*.whl")
    if reason:
        give_up(reason)


@pytest.fixture
def wheel() -> ZipFile:
    return ZipFile(built("*.whl"))


@pytest.fixture
def metadata(wheel: ZipFile) -> Message:
    (name,) = [name for name in wheel.namelist() if name.endswith(".dist-info/METADATA")]
    return message_from_string(wheel.read(name).decode())


def links_of(text: str) -> list[str]:
    return re.findall(r"\]\(([^()\s]+)\)", text)


def test_the_wheel_carries_scenes_examples_and_units(wheel: ZipFile) -> None:
    names = set(wheel.namelist())

    scenes = {f"beamtouch_models/scenes/{path.name}" for path in (ROOT / "models" / "scenes").glob("*.toml")}
    assert scenes
    assert scenes <= names
    for program in ("daemon", "service"):
        assert f"beamtouch_{program}/examples/{program}.example.toml" in names
        unit = f"beamtouch_{program}/units/beamtouch-{program}.service"
        assert wheel.read(unit) == (ROOT / program / f"beamtouch-{program}.service").read_bytes()
    assert not [name for name in names if name.startswith(("tests", "docs", "demo"))]


def test_the_source_distribution_has_what_a_packager_needs() -> None:
    with tarfile.open(built("*.tar.gz")) as source:
        names = {name.partition("/")[2] for name in source.getnames()}

    assert {"Makefile", "LICENSE", "SECURITY.md", "CITATION.cff", "constraints.txt", "mkdocs.yml"} <= names
    assert {"packaging/debian/build", "docs/tutorial/index.md", "tests/conftest.py", "deploy/haproxy.cfg"} <= names


def test_links_and_pictures_of_the_readme_hold_outside_the_repository(metadata: Message) -> None:
    readme = str(metadata.get_payload())

    assert len(links_of(readme)) > 15
    assert all(link.startswith("https://") for link in links_of(readme))
    assert metadata["Description-Content-Type"].startswith("text/markdown")


def test_the_metadata_say_what_it_is(metadata: Message) -> None:
    pages = dict(line.split(", ") for line in metadata.get_all("Project-URL", []))

    assert pages == PROJECT["urls"]
    assert metadata["License-Expression"] == PROJECT["license"]
    assert len(metadata.get_all("Classifier", [])) > 10


def test_links_to_pages_lead_to_the_site_and_others_to_the_repository() -> None:
    known = addresses(PYPROJECT)
    text = "[a](docs/tutorial/index.md#x) ![b](docs/beam.svg) [c](LICENSE) [d](docs/how-to/plc.md) [e](#here)"

    assert links_of(absolute(text, known)) == [
        f"{known.site}tutorial/#x",
        f"{known.site}beam.svg",
        f"{known.repository}/blob/main/LICENSE",
        f"{known.site}how-to/plc/",
        "#here",
    ]
    assert absolute(f"```\n{text}\n```", known) == f"```\n{text}\n```"


def test_every_link_of_the_readme_has_its_target_in_the_repository() -> None:
    links = [link.partition("#")[0] for link in links_of((ROOT / "README.md").read_text())]

    assert [link for link in links if link and "://" not in link and not (ROOT / link).exists()] == []


def test_the_addresses_and_the_version_stand_in_one_place() -> None:
    host = addresses(PYPROJECT).site.split("/")[2]
    tracked = subprocess.run(["git", "grep", "-lF", host], cwd=ROOT, capture_output=True, text=True, check=False)
    email = PROJECT["maintainers"][0]["email"]
    named = subprocess.run(["git", "grep", "-lF", email], cwd=ROOT, capture_output=True, text=True, check=False)

    assert tracked.stdout.split() == ["pyproject.toml"]
    assert named.stdout.split() == ["pyproject.toml"]
    assert f"\nversion: {PROJECT['version']}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"\n## {PROJECT['version']}" in (ROOT / "CHANGELOG.md").read_text()
