"""Values and errors in the words of TOML, the language in which a user states them."""

import json
import re
from collections.abc import Mapping
from datetime import date, datetime, time

from pydantic import BaseModel

_MAX_SHOWN = 80
"""Longest value in a message, in characters."""
_MAX_DEEP = 20
"""Deepest nesting of a value that is shown."""
_PYTHON_KEYS = re.compile(r"\(('[^']*'(?:, '[^']*')*),?\)")
"""Names of a table as the parser prints them: ('surfaces', 'press-7')."""
_HINTS = {
    "Invalid value": "; text needs quotes, and true and false are in lower case",
    "Cannot overwrite a value": "; the key is there twice",
}
"""Complaints of the parser, with what usually causes them."""
_ENDS_EARLY = {
    r"[+-]?\d+,\d": "; write decimals with a point",
    r"[+-]?[\d.]+ *[^\W\d_][^=]*$": "; give the number alone, its unit is in the name of the key",
    r"\d+\.\d+\.\d": "; text needs quotes",
}
"""Values that begin with a number: the parser complains about what follows it. With each, what to do."""


def given(value: object) -> str:
    """Return a value in brackets; nothing for a whole table, and for what is too long or too deep to show."""
    if isinstance(value, Mapping | BaseModel):
        return ""
    try:
        text = toml_of(value)
    except (ValueError, RecursionError):
        return ""
    return f" (given: {text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 3] + '...'})"


def toml_of(value: object, deep: int = 0) -> str:
    """Return a value as TOML; ValueError if it is nested too deeply or has too many digits."""
    if deep > _MAX_DEEP:
        message = "nested too deeply"
        raise ValueError(message)
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return json.dumps(value, ensure_ascii=False)
        case datetime() | date() | time():
            return value.isoformat()
        case list() | tuple():
            return f"[{', '.join(toml_of(part, deep + 1) for part in value)}]"
        case Mapping():
            return "{ " + ", ".join(f"{key} = {toml_of(part, deep + 1)}" for key, part in value.items()) + " }"
    return str(value)


def parser_complaint(error: Exception, source: str) -> str:
    """Return what the TOML parser complains about in a text, and what to do."""
    if isinstance(error, RecursionError):
        return "its values are nested too deeply"
    text = str(error)
    if "integer string conversion" in text:
        return "a number has too many digits"
    text = _PYTHON_KEYS.sub(lambda found: "[" + ".".join(re.findall(r"'([^']*)'", found[1])) + "]", text)
    line = re.search(r"^Expected newline .* \(at line (\d+),", text)
    if line is not None:
        return text + _hint(source.split("\n")[int(line[1]) - 1])
    for theirs, hint in _HINTS.items():
        text = text + hint if text.startswith(theirs) else text
    return text


def _hint(line: str) -> str:
    """Return what to do about a line with something behind its value."""
    value = line.partition("=")[2].strip()
    return next((hint for start, hint in _ENDS_EARLY.items() if re.match(start, value)), "; give one key per line")
