"""The first complaint of pydantic about a file in one line of plain words: key, what is wrong, what to do."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from beamtouch_common.known_keys import header_of, meant
from beamtouch_common.plain_toml import given
from beamtouch_common.reasons import is_of_another_kind, one_of, reason_of

Content = Mapping[str, Any]


def complaint(error: ValidationError, kind: type[BaseModel], content: Content) -> str:
    """Return the first complaint in one line, with the number of further ones.

    Parameters
    ----------
    error : the error of pydantic
    kind : the model of the whole file
    content : the file
    """
    # A misspelt key is also a missing one. The user can see the spelling, so it comes first.
    found = sorted(error.errors(include_url=False), key=lambda one: one["type"] != "extra_forbidden")
    first, *others = _without_alternatives(found, content)
    key = _key_path(first["loc"], content, is_missing=first["type"] == "missing")
    last = first["loc"][-1] if first["loc"] else ""
    match first["type"]:
        case "extra_forbidden":
            table = _at(content, first["loc"][:-1])
            present = [name for name in table if name != last] if isinstance(table, Mapping) else []
            text = f"unknown key {key}; {meant(kind, first['loc'], present) or 'remove it or correct its spelling'}"
        case "missing" if isinstance(last, int):
            entries = _at(content, first["loc"][:-1])
            had = len(entries) if isinstance(entries, list) else last
            needed = last + 1 + sum(one["loc"][:-1] == first["loc"][:-1] for one in others)
            others = [one for one in others if one["loc"][:-1] != first["loc"][:-1]]
            text = f"{key.rpartition('[')[0]}: must have {needed} entries, not {had}" + given(entries)
        case "missing":
            text = f"{header_of(kind, first['loc'], key)} is missing; add it"
        case "union_tag_not_found":
            text = f"{_tag(key, first['ctx'])} is missing; add it"
        case "union_tag_invalid":
            context = first["ctx"]
            tag = context["tag"]
            text = f"{_tag(key, context)}: must be {one_of(context['expected_tags'], tag)}" + given(tag)
        case _:
            text = (f"{key}: " if key else "") + reason_of(first, key) + given(first["input"])
    return text + (f" (and {len(others)} more)" if others else "")


def _without_alternatives(errors: list[ErrorDetails], content: Content) -> list[ErrorDetails]:
    """Return the errors without those of alternatives that a value was not meant to be.

    If a value may be of several kinds, pydantic complains once for each. Those about a kind that the value has say
    more; if it has none of them, one error names all.
    """
    groups: dict[tuple[int | str, ...], list[ErrorDetails]] = {}
    for error in errors:
        root = _union_root(error, content)
        groups.setdefault(error["loc"] if root is None else root, []).append(error)
    found: list[ErrorDetails] = []
    for root, group in groups.items():
        if len({error["loc"][: len(root) + 1] for error in group}) == 1:
            found += group
        elif closer := [error for error in group if len(error["loc"]) > len(root) + 1 or not is_of_another_kind(error)]:
            kept = closer[0]["loc"][len(root)]
            found += [error for error in closer if error["loc"][len(root)] == kept]
        else:
            numeric = any(error["type"] in ("float_type", "int_type") for error in group)
            reasons = dict.fromkeys(reason_of(error, numeric=numeric).removeprefix("must be ") for error in group)
            *before, last = reasons
            text = f"must be {' or '.join([', '.join(before), last] if before else [last])}"
            found.append({**group[0], "type": "alternatives", "msg": text})
    return found


def _union_root(error: ErrorDetails, content: object) -> tuple[int | str, ...] | None:
    """Return the place of the value that may be of several kinds; None if there is none on the way."""
    here, location = content, error["loc"]
    for place, part in enumerate(location, start=1):
        is_missing = error["type"] == "missing" and place == len(location)
        if is_missing or here is None:
            return None
        if isinstance(here, Mapping) and part in here:
            here = here[str(part)]
        elif isinstance(here, list) and isinstance(part, int):
            here = here[part] if part < len(here) else None
        else:
            return tuple(location[: place - 1])
    return None


def _tag(key: str, context: Mapping[str, Any]) -> str:
    """Return the key in a table that names the kind of the table."""
    name = context["discriminator"].strip("'")
    return f"{key}.{name}" if key else name


def _at(content: object, location: Sequence[int | str]) -> object:
    """Return the value at a place; parts that pydantic adds are passed over."""
    for part in location:
        if isinstance(content, Mapping):
            content = content.get(str(part), content)
        elif isinstance(content, list) and isinstance(part, int):
            content = content[part] if part < len(content) else None
    return content


def _key_path(location: Sequence[int | str], content: object, *, is_missing: bool) -> str:
    """Return a key as in the file, without what pydantic adds: the kinds of which a value may be."""
    path, here = "", content
    for place, part in enumerate(location, start=1):
        if isinstance(part, int):
            path += f"[{part}]"
            here = here[part] if isinstance(here, Sequence) and part < len(here) else None
        elif isinstance(here, Mapping) and (part in here or (is_missing and place == len(location))):
            path += f".{part}"
            here = here.get(part)
    return path.removeprefix(".")
