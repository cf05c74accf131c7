"""Commands and files in all pages fit the programs: each command exists, takes these options, and reads these keys."""

import re
import tomllib
from collections.abc import Iterator
from functools import cache

import jsonschema
import pytest

from beamtouch_models.design.scene.schema import editor_schema
from helps import PROGRAMS, all_helps, help_of
from reference import FILES
from support.pages.pasted import COMMANDS, ROOT, blocks_of

FOUND = [page.relative_to(ROOT) for page in (*ROOT.glob("*.md"), *ROOT.glob("[a-z]*/**/*.md"))]
PAGES = [str(page) for page in FOUND if page.parts[0] != "build"]
_NAMES = "|".join(PROGRAMS)
_COMMAND = re.compile(
    rf"(?:^|[$;|{{(`]|\bdo|\buntil|\bsudo(?: -\w+ \S+)*) *({_NAMES})((?: +[^\s|&<>#;`)]+)*)", re.MULTILINE
)
_FILE = re.compile(r"cat > (\S+\.toml) <<'?END'?\n(.*?)^END$", re.MULTILINE | re.DOTALL)


@cache
def helps() -> dict[str, str]:
    return dict(all_helps())


def commands_in(page: str) -> Iterator[tuple[str, list[str]]]:
    """Yield each command in the blocks of a page, as `beamtouch-daemon check`, with its options."""
    for block in blocks_of(page):
        if block.word in (COMMANDS, "console"):
            for program, rest in _COMMAND.findall(block.text.replace("\\\n", " ")):
                words = rest.split()
                has_commands = any(name.startswith(f"{program} ") for name in helps())
                command = f"{program} {words[0]}" if has_commands and words and words[0][0] != "-" else program
                yield command, [word for word in words if re.fullmatch("--[a-z-]+", word)]


def test_every_command_in_a_page_exists_and_takes_its_options() -> None:
    found = [(page, *one) for page in PAGES for one in commands_in(page)]
    wrong = [
        f"{page}: {command} {option}"
        for page, command, options in found
        for option in options or [""]
        if command not in helps() or not re.search(rf"{option}(?![a-z-])", helps()[command])
    ]
    assert len(found) > 60
    assert len({command for _, command, _ in found}) > 15
    assert wrong == []


@pytest.mark.parametrize("page", [page for page in PAGES if any(_FILE.search(block.text) for block in blocks_of(page))])
def test_every_file_that_a_page_writes_has_the_keys_of_its_kind(page: str) -> None:
    kinds = {name: jsonschema.Draft202012Validator(editor_schema(*FILES[name])) for name in FILES}
    for block in blocks_of(page):
        for name, text in _FILE.findall(block.text):
            keys = tomllib.loads(text)
            if set(keys) == {"zones"}:  # a file for `explain --zones` has the zones of a surface
                keys = {"surfaces": {"strip": keys}}
            assert any(kind.is_valid(keys) for kind in kinds.values()), f"{page}: {name}"


SHOWN = re.findall(
    r"^##+ ([a-z-]+)((?: [a-z-]+)?)\n\n```text\n(.*?)^```$",
    (ROOT / "docs" / "reference" / "commands.md").read_text(),
    re.MULTILINE | re.DOTALL,
)


@pytest.mark.parametrize(("program", "command", "text"), SHOWN, ids=[f"{one}{other}" for one, other, _ in SHOWN])
def test_the_page_of_the_commands_shows_what_help_prints(
    monkeypatch: pytest.MonkeyPatch, program: str, command: str, text: str
) -> None:
    monkeypatch.setenv("COLUMNS", "96")
    monkeypatch.setenv("NO_COLOR", "1")
    # Each version of Python breaks lines in its own way.
    assert help_of(PROGRAMS[program], *command.split()).split() == text.split()


def test_the_page_of_the_commands_shows_all_of_them() -> None:
    assert [f"{program}{command}" for program, command, _ in SHOWN] == list(helps())
