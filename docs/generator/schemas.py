"""The reference of the keys of a file that people write, from its JSON Schema."""

import json
from collections.abc import Iterator, Mapping, Sequence

from beamtouch_models.design.scene.schema import Schema


def keys_of(schema: Schema) -> Iterator[tuple[str, str, Schema]]:
    """Yield table, key and schema of every key in a schema; the table of the whole file is its title."""
    for table, part in tables_of(schema).items():
        for key, value in part.get("properties", {}).items():
            yield table, key, value


def tables_of(schema: Schema) -> dict[str, Schema]:
    """Return the tables of a schema by name: the whole file first, then in the order in which they are used."""
    found: dict[str, Schema] = {}

    def visit(name: str, part: Schema) -> None:
        if name in found:
            return
        found[name] = part
        for used in _references(part.get("properties", {})):
            visit(used, schema["$defs"][used])

    visit(schema["title"], {name: value for name, value in schema.items() if name != "$defs"})
    return {name: part for name, part in found.items() if "properties" in part}


def _references(part: object) -> Iterator[str]:
    if isinstance(part, list):
        for one in part:
            yield from _references(one)
    elif isinstance(part, dict):
        for name, value in part.items():
            if name == "$ref":
                yield value.rpartition("/")[2]
            elif name != "mapping":
                yield from _references(value)


def type_of(part: Schema, defs: Mapping[str, Schema]) -> str:
    """Return the type of a value in words, with its bounds."""
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        target = defs[name]
        return f"[{name}](#{name.lower()})" if "properties" in target else type_of(target, defs)
    if choices := part.get("anyOf") or part.get("oneOf"):
        return " or ".join(dict.fromkeys(type_of(one, defs) for one in choices))
    if values := part.get("enum") or ([part["const"]] if "const" in part else []):
        return " or ".join(map(_code, values))
    return _collection(part, defs) or _WORDS.get(part.get("type", ""), "any") + _bounds(part)


_WORDS = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false", "null": "null"}


def _collection(part: Schema, defs: Mapping[str, Schema]) -> str:
    """Return the type of a list or of tables by name in words; empty for a single value."""
    if "prefixItems" in part:
        items, bounds = part["prefixItems"], {_bounds(one) for one in part["prefixItems"]}
        types = ", ".join(type_of(one, defs).removesuffix(_bounds(one)) for one in items)
        # Bounds inside the pair would hide it; those that differ are in the words about the key.
        alike = bounds.pop() if len(bounds) == 1 else ""
        return f"[{types}]{alike and ', each' + alike.removeprefix(',')}"
    if part.get("type") == "array":
        return f"list of {type_of(part.get('items', {}), defs)}"
    if isinstance(part.get("additionalProperties"), dict):
        return f"tables by name, each {type_of(part['additionalProperties'], defs)}"
    if "patternProperties" in part:
        (inner,) = part["patternProperties"].values()
        return f"tables by name, each {type_of(inner, defs)}"
    return ""


def _bounds(part: Schema) -> str:
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    stated = [f"{sign} {part[name]:g}" for name, sign in signs.items() if name in part]
    return f", {', '.join(stated)}" if stated else ""


def _code(value: object) -> str:
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def default_of(part: Schema) -> str:
    """Return the default of a key as TOML, or an empty text."""
    value = part.get("default")
    return "" if value is None or value in ({}, []) or isinstance(value, dict) else _code(value)


def keys_as_markdown(schema: Schema, level: int = 2, first: str = "The whole file") -> str:
    """Return the reference of a schema: a heading and a table of keys for each of its tables, `first` for the first."""
    parts: list[str] = []
    for number, (name, part) in enumerate(tables_of(schema).items()):
        heading = first if number == 0 else name
        parts.append(f"{'#' * level} {heading}")
        if part.get("description"):
            parts.append(part["description"])
        parts.append(_table(part, schema.get("$defs", {})))
    return "\n\n".join(parts)


def members_beside(schema: Schema, known: Schema, level: int, first: str) -> str:
    """Return the members of an answer that another one lacks: a heading and a table of keys for each of its tables.

    Parameters
    ----------
    schema, known : of the answer and of the other one, with tables in the same order
    first : heading of the first table
    """
    parts: list[str] = []
    pairs = zip(tables_of(schema).items(), tables_of(known).values(), strict=True)
    for number, ((name, part), other) in enumerate(pairs):
        members = {key: value for key, value in part["properties"].items() if key not in other["properties"]}
        if members:
            parts.append(f"{'#' * level} {first if number == 0 else name}")
            parts.append(_table(part | {"properties": members}, schema.get("$defs", {})))
    return "\n\n".join(parts)


def _table(part: Schema, defs: Mapping[str, Schema]) -> str:
    required = part.get("required", [])
    rows = [
        (
            f"`{key}`",
            type_of(value, defs),
            "required" if key in required else default_of(value),
            value.get("description", ""),
        )
        for key, value in part["properties"].items()
    ]
    return table(("key", "value", "default", "meaning"), rows)


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Return a Markdown table; line ends and bars in its cells are replaced."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join(
        "| " + " | ".join(" ".join(cell.replace("|", "\\|").split()) for cell in line) + " |" for line in lines
    )
