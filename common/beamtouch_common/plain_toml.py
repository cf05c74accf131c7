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
    "Expected newline or end of document after a statement": "; give one key per line, and decimals a point",
}
"""Complaints of the parser, with what usually causes them."""


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


def parser_complaint(error: Exception) -> str:
    """Return what the TOML parser complains about."""
    if isinstance(error, RecursionError):
        return "its values are nested too deeply"
    text = str(error)
    if "integer string conversion" in text:
        return "a number has too many digits"
    text = _PYTHON_KEYS.sub(lambda found: "[" + ".".join(re.findall(r"'([^']*)'", found[1])) + "]", text)
    for theirs, hint in _HINTS.items():
        text = text + hint if text.startswith(theirs) else text
    return text
