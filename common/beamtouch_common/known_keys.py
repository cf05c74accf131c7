"""The keys that a pydantic model knows, by table, and the one that a misspelt key may mean."""

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel

_ALIKE = 0.7
"""Smallest similarity of a key to the one that is suggested, of 0 to 1."""
_MAX_DEPTH = 8
"""Deepest table that is searched."""


def meant(kind: type[BaseModel], location: Sequence[int | str], present: Sequence[str]) -> str:
    """Return what a user may have meant by an unknown key, as the end of a message; empty if nothing is like it.

    Parameters
    ----------
    kind : the model of the whole file
    location : place of the key, as pydantic reports it
    present : keys that its table has already
    """
    key = str(location[-1])
    own = {name for model in _models_at(kind, location[:-1]) for name in _fields(model)} - set(present)
    without_unit = [name for name in sorted(own) if name.startswith(f"{key}_")]
    near = get_close_matches(key, sorted(own), n=1, cutoff=_ALIKE) or (without_unit if len(without_unit) == 1 else [])
    if near:
        return f"did you mean {near[0]}?"
    elsewhere = [path for path, model in _tables(kind) if key in _fields(model)]
    return f"it belongs in {_table(elsewhere[0])}" if elsewhere else ""


def header_of(kind: type[BaseModel], location: Sequence[int | str], key: str) -> str:
    """Return a key as it stands in the file: a table in brackets, several tables in two, and others as they are."""
    name = str(location[-1])
    annotations = [fields[name] for model in _models_at(kind, location[:-1]) if name in (fields := _fields(model))]
    if not [model for annotation in annotations for model in _models_in(annotation)]:
        return key
    parts = [part for annotation in annotations for part in (annotation, *get_args(annotation))]
    if any(get_origin(part) in (list, tuple) for part in parts):
        return f"[[{key}]]"
    return f"[{key}.NAME]" if any(get_origin(part) is dict for part in parts) else f"[{key}]"


def _table(path: str) -> str:
    return f"[{path}]" if path else "the file before all tables"


def _fields(model: type[BaseModel]) -> dict[str, Any]:
    """Return the fields of a model, by their keys."""
    return {field.alias or name: field.annotation for name, field in model.model_fields.items()}


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    """Yield the models that a value with this annotation may be, or hold in a list or by name."""
    if isinstance(annotation, type) and get_origin(annotation) is None:
        if issubclass(annotation, BaseModel):
            yield annotation
        return
    if get_origin(annotation) is not Literal:
        for part in get_args(annotation):
            yield from _models_in(part)


def _models_at(kind: type[BaseModel], location: Sequence[int | str]) -> list[type[BaseModel]]:
    """Return the models of the table at a place; a part of the place may also be an index, a name or a tag."""
    models = [kind]
    for part in location:
        fields = [_fields(model)[part] for model in models if part in _fields(model)]
        if fields:
            models = [found for annotation in fields for found in _models_in(annotation)]
        else:
            models = [model for model in models if _has_tag(model, part)] or models
    return models


def _has_tag(model: type[BaseModel], tag: int | str) -> bool:
    literals = (get_args(one) for one in _fields(model).values() if get_origin(one) is Literal)
    return any((tag,) == values for values in literals)


def _tables(kind: type[BaseModel], path: str = "", depth: int = 0) -> Iterator[tuple[str, type[BaseModel]]]:
    """Yield every table of a file with its name; those that a user names are NAME."""
    yield path, kind
    if depth == _MAX_DEPTH:
        return
    for key, annotation in _fields(kind).items():
        named = any(get_origin(one) is dict for one in (annotation, *get_args(annotation)))
        below = f"{path}.{key}".removeprefix(".") + (".NAME" if named else "")
        for model in _models_in(annotation):
            yield from _tables(model, below, depth + 1)
