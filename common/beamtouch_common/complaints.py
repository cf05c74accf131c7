"""The first complaint about a TOML file in one line of plain words: key, what is wrong, what to do."""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from beamtouch_common.names import NAME, RULE

_MAX_SHOWN = 80
"""Longest value in a message, in characters."""
_ALIKE = 0.7
"""Smallest similarity of a key to the one that is suggested, of 0 to 1."""
_HINTS = {
    "Expected newline": "; one key per line, text in quotes, decimals with a point, and no unit behind a number",
    "Invalid value": "; text needs quotes, and true and false are in lower case",
    "Cannot overwrite": "; the key is there twice",
}
"""Beginnings of complaints of the TOML parser, with what usually causes them."""
_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text in quotes",
    "path_type": "a path in quotes",
    "bool_type": "true or false",
    "tuple_type": "a list, as [1, 2]",
    "list_type": "a list, as [1, 2]",
    "dict_type": "one table, as { key = 1 }",
    "model_type": "one table, as { key = 1 }",
    "model_attributes_type": "one table, as { key = 1 }",
}
"""Types of errors that mean a value of another kind -> the kind that it must have."""
_PLAIN = {
    "be greater than or equal to": "be at least",
    "be less than or equal to": "be at most",
    "be greater than": "be more than",
    " after validation": "",
    f"match pattern '{NAME}'": RULE,
    "match pattern": "match the pattern",
}
"""Phrases of pydantic in plain words."""
_FILES = {
    "a scene": {"beam", "contact", "sensors", "requirements", "environment"},
    "a configuration of the daemon": {"publish", "metrics"},
    "a configuration of the service": {"server", "events", "modbus_server", "mqtt", "opcua"},
    "a script of the rig": {"step"},
}
"""Tables that only one kind of file has."""


def complaint(error: ValidationError, kind: type[BaseModel], content: Mapping[str, Any]) -> str:
    """Return the first complaint of pydantic in one line, with the number of further ones.

    Parameters
    ----------
    error : the error of pydantic
    kind : the model of the whole file
    content : the file
    """
    (key, errors), *others = sorted(_by_key(error, content).items(), key=_order)
    return _line(key, errors, kind) + (f" (and {len(others)} more)" if others else "")


def parser_complaint(error: Exception) -> str:
    """Return what the TOML parser complains about, and what to do."""
    if not isinstance(error, tomllib.TOMLDecodeError):
        return "its values are nested too deeply, or a number has too many digits"
    text = re.sub(r"\('(.*)',?\)", lambda match: f"[{match[1].replace(chr(39) + ', ' + chr(39), '.')}]", str(error))
    return text + next((hint for start, hint in _HINTS.items() if text.startswith(start)), "")


def reason_of(error: ErrorDetails) -> str:
    """Return what is wrong with a value, without the key and the value."""
    if error["type"] == "literal_error":
        return f"must be {_one_of(error['ctx']['expected'], error['input'])}"
    if error["type"] in _KINDS:
        return f"must be {_KINDS[error['type']]}"
    text = error["msg"].removeprefix("Value error, ")
    for theirs, plain in _PLAIN.items():
        text = text.replace(theirs, plain)
    return re.sub(r"^\w+ should ", "must ", text)


def _by_key(error: ValidationError, content: Mapping[str, Any]) -> dict[str, list[ErrorDetails]]:
    """Return the errors by their key.

    If a value may be of several kinds, pydantic complains once for each. A complaint about a part of it says more than
    that it is not of some other kind.
    """
    groups: dict[str, list[ErrorDetails]] = {}
    for each in error.errors(include_url=False):
        groups.setdefault(_key_of(each, content), []).append(each)
    complaints: dict[str, list[ErrorDetails]] = {}
    for key, errors in groups.items():
        exact = [each for each in errors if not _is_of_another_kind(each)]
        if exact or not any(other.startswith((f"{key}.", f"{key}[")) for other in groups):
            complaints[key] = exact or errors
    return complaints


def _is_of_another_kind(error: ErrorDetails) -> bool:
    return error["type"] in _KINDS or error["type"] == "literal_error"


def _order(item: tuple[str, list[ErrorDetails]]) -> tuple[bool, int]:
    """Sort unknown keys first, those of the whole file before those of its tables.

    A misspelt key is also a missing one, and the user can see the spelling.
    """
    first = item[1][0]
    is_unknown = first["type"] == "extra_forbidden"
    return not is_unknown, len(first["loc"]) if is_unknown else 0


def _key_of(error: ErrorDetails, content: object) -> str:
    """Return a key as in the file, without what pydantic adds to it: the kinds of which a value may be.

    An entry that a list lacks is an error of the list.
    """
    path, here, location = "", content, error["loc"]
    is_missing = error["type"] == "missing"
    for place, part in enumerate(location, start=1):
        is_last = place == len(location)
        if isinstance(part, int) and not (is_missing and is_last):
            path += f"[{part}]"
            here = here[part] if isinstance(here, Sequence) and part < len(here) else None
        elif isinstance(here, Mapping) and (part in here or (is_missing and is_last)):
            path += f".{part}"
            here = here.get(part)
    return path.removeprefix(".")


def _line(key: str, errors: list[ErrorDetails], kind: type[BaseModel]) -> str:
    """Return the complaint about one key."""
    first = errors[0]
    location, value, context = first["loc"], first["input"], first.get("ctx", {})
    tag = f"{key}.{context.get('discriminator', '')}".replace("'", "").removeprefix(".")
    match first["type"]:
        case "extra_forbidden":
            return f"unknown key {key}; {_meant(kind, location)}"
        case "missing" if isinstance(location[-1], int):
            return f"{key}: must have {location[-1] + len(errors)} entries, not {len(value)}{_given(value)}"
        case "missing":
            return f"{key} is missing; add it"
        case "union_tag_not_found":
            return f"{tag} is missing; add it"
        case "union_tag_invalid":
            return f"{tag}: must be {_one_of(context['expected_tags'], context['tag'])}{_given(context['tag'])}"
    *before, last = dict.fromkeys(reason_of(each).removeprefix("must be ") for each in errors)
    reason = f"must be {', '.join(before)} or {last}" if before else reason_of(first)
    return (f"{key}: " if key else "") + reason + _given(value)


def _given(value: object) -> str:
    """Return a value in brackets; nothing for tables, and for what cannot be shown."""
    if any(isinstance(part, Mapping | BaseModel) for part in (value if isinstance(value, list) else [value])):
        return ""
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except (ValueError, RecursionError):  # too many digits, too deep
        return ""
    return f" (given: {text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 3] + '...'})"


def _one_of(expected: str, value: object) -> str:
    """Return what a value must be one of, with the one that it may mean; `expected` is as pydantic prints it."""
    names = re.findall(r"'([^']*)'", expected)
    if not names:
        return expected
    *before, last = [f'"{name}"' for name in names]
    text = f"{', '.join(before)} or {last}" if before else last
    near = get_close_matches(value, names, n=1) if isinstance(value, str) and before else []
    return f'{text}; did you mean "{near[0]}"?' if near else text


_AXES = ({"position_mm"}, {"x_mm", "y_mm"})
"""Keys of a place on a beam and on a plate."""


def _meant(kind: type[BaseModel], location: Sequence[int | str]) -> str:
    """Return what a user may have meant by the unknown key at a place."""
    tables: dict[str, set[str]] = {}
    for path, keys in _tables(kind):
        tables.setdefault(path, set()).update(keys)
    here, key = "", str(location[-1])
    for part in location[:-1]:  # a part may also be an index, a name or a kind
        below = f"{here}.{part}".removeprefix(".")
        here = next((path for path in (below, f"{below}.NAME") if path in tables), here)
    own = sorted(tables[here])
    if key in own:
        return "it belongs to another kind; remove it"
    for file, keys in _FILES.items():
        if len(location) == 1 and key in keys and not keys & set(own):
            return f"it belongs in {file}; is this the right file?"
    other = next((axes for axes in _AXES if key not in axes and axes <= set(own)), None)
    if other and any(key in axes for axes in _AXES):
        return f"places are stated as {' and '.join(sorted(other))} here"
    longer = [name for name in own if name.startswith(f"{key}_") or name.endswith(f"_{key}")]
    near = longer if 1 <= len(longer) <= 3 else get_close_matches(key, own, n=1, cutoff=_ALIKE)
    if near:
        *most, last = near
        return f"did you mean {', '.join(most)}{' or ' if most else ''}{last}?"
    elsewhere = [path for path, keys in tables.items() if key in keys]
    if elsewhere:
        return f"it belongs in {f'[{elsewhere[0]}]' if elsewhere[0] else 'the file before all tables'}"
    return "remove it or correct its spelling"


def _tables(kind: type[BaseModel], path: str = "") -> Iterator[tuple[str, set[str]]]:
    """Yield the name of every table of a file with its keys; tables that a user names are NAME."""
    fields = {field.alias or name: field.annotation for name, field in kind.model_fields.items()}
    yield path, set(fields)
    for key, annotation in fields.items():
        named = ".NAME" if get_origin(annotation) is dict else ""
        for model in _models_in(annotation):
            yield from _tables(model, f"{path}.{key}".removeprefix(".") + named)


def _models_in(annotation: object) -> list[type[BaseModel]]:
    """Return the models that a value with this annotation may be, or hold in a list or by name."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]
