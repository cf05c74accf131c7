"""A table of fields: one row each, from which every output and its documents are made."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, create_model
from pydantic import Field as ModelField

Source = TypeVar("Source")
"""What the values of a table are read from."""


@dataclass(frozen=True, slots=True)
class Field(Generic[Source]):
    """One field of an answer."""

    name: str
    type: Any
    """Its type in JSON. A whole number is a count, so it is never negative."""
    meaning: str
    """The first sentence says it in short, for a variable."""
    get: Callable[[Source], Any]
    """Returns its value as JSON has it; None where there is none."""
    unit: str = ""
    is_variable: bool = True
    """True if OPC UA has it, too."""
    is_optional: bool = False
    """True if JSON leaves it out while it is empty."""
    example: Any = None
    """A value of it, for documents."""
    label: str = ""
    """Its name on the page, as a large figure or as a column; empty if it is neither."""


def model_of(name: str, words: str, fields: Iterable[Field[Any]]) -> type[BaseModel]:
    """Return a table as a model of pydantic, with a name and a description, for OpenAPI and documents."""
    rows = list(fields)
    members: dict[str, Any] = {
        field.name: (
            field.type,
            ModelField(default_factory=dict, description=field.meaning)
            if field.is_optional
            else ModelField(description=field.meaning),
        )
        for field in rows
    }
    has_example = any(field.example is not None for field in rows)
    config = ConfigDict(json_schema_extra={"examples": [example_of(rows)]}) if has_example else None
    return create_model(name, __doc__=words, __config__=config, **members)


def example_of(fields: Iterable[Field[Any]]) -> dict[str, Any]:
    """Return an answer with the examples of a table, without optional fields that have none."""
    return {field.name: field.example for field in fields if field.example is not None or not field.is_optional}


def members_of(fields: Iterable[Field[Source]], source: Source) -> dict[str, Any]:
    """Return the values of the fields of a table by name, without optional ones that are empty."""
    members = {}
    for field in fields:
        value = field.get(source)
        if value or not field.is_optional:
            members[field.name] = value
    return members
