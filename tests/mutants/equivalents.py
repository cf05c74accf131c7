"""Mutants that no user could tell from the code, judged by hand: `equivalent/` has a list for each part.

`before` and `after` are the lines of a mutant as `make mutants` prints them; `why` is the reason.
"""

import tomllib
from pathlib import Path

FOLDER = Path(__file__).parent / "equivalent"


def listed() -> list[dict[str, str]]:
    """Return all entries: `file`, from the top folder, `before`, `after` and `why`."""
    return [one for path in sorted(FOLDER.glob("*.toml")) for one in tomllib.loads(path.read_text())["equivalent"]]


def reasons() -> dict[tuple[str, str, str], str]:
    """Return why a mutant changes nothing, by file and lines before and after."""
    return {(one["file"], one["before"].strip(), one["after"].strip()): one["why"] for one in listed()}
