"""Replaces tables in the text of a configuration; the rest of it, with its comments, stays. Pure; no I/O."""

import json
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any


class NoTableError(Exception):
    """The text has no such table; the message names it."""


def toml_of(settings: Mapping[str, str | float]) -> list[str]:
    """Return the lines of a table."""
    return [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in settings.items()]


def with_source(text: str, surface: str, settings: Mapping[str, str | float]) -> str:
    """Return a configuration with another source of a surface; NoTableError if it has no table of the source."""
    return _with_table(text, ("surfaces", surface, "source"), settings, keeps_others=False)


def with_publish(text: str, settings: Mapping[str, str]) -> str:
    """Return a configuration with another service; NoTableError if it has no table [publish]."""
    return _with_table(text, ("publish",), settings, keeps_others=True)


def _with_table(text: str, names: Sequence[str], settings: Mapping[str, str | float], *, keeps_others: bool) -> str:
    lines = text.replace("\r\n", "\n").split("\n")  # not splitlines: other line ends may stand in a comment
    begin = next((place for place, line in enumerate(lines) if _names_in(line) == list(names)), None)
    if begin is None:
        message = f"has no table [{'.'.join(names)}]"
        raise NoTableError(message)
    rest = enumerate(lines[begin + 1 :], begin + 1)
    end = next((place for place, line in rest if line.lstrip().startswith("[")), len(lines))
    others = [line for line in lines[begin + 1 : end] if keeps_others and line.strip() and not _states(line, settings)]
    return "\n".join([*lines[: begin + 1], *toml_of(settings), *others, "", *lines[end:]]).rstrip("\n") + "\n"


def _names_in(line: str) -> list[str]:
    """Return the names in the header of a table; empty if the line is none."""
    names: list[str] = []
    try:
        content: Any = tomllib.loads(line) if line.lstrip().startswith("[") else {}
    except tomllib.TOMLDecodeError:  # a piece of an array of several lines
        return names
    while isinstance(content, dict) and len(content) == 1:
        ((name, content),) = content.items()
        names.append(name)
    return names


def _states(line: str, settings: Mapping[str, str | float]) -> bool:
    return line.partition("=")[0].strip().strip("'\"") in settings
