"""A configuration with one of its numbers replaced by another kind of value."""

import copy
from collections.abc import Iterator
from typing import Any


def with_wrong_numbers(content: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield copies with a number as text, as true and as a list in its place, each with the place and the value."""
    for path in numbers_in(content):
        for wrong in ("1", True, [[1]]):
            yield f"{'.'.join(map(str, path))} = {wrong!r}", with_value(content, path, wrong)


def with_value(content: dict[str, Any], path: tuple[str | int, ...], value: object) -> dict[str, Any]:
    """Return a copy with another value at a place."""
    changed = copy.deepcopy(content)
    part: Any = changed
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    return changed


def numbers_in(content: object, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Return the places of all numbers in a configuration."""
    if isinstance(content, dict):
        return [found for key, part in content.items() for found in numbers_in(part, (*path, key))]
    if isinstance(content, list):
        return [found for index, part in enumerate(content) for found in numbers_in(part, (*path, index))]
    return [path] if isinstance(content, int | float) and not isinstance(content, bool) else []
