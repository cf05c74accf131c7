"""Rows as they are read: each is whole, or its damage is told with its table, its column and what it is the row of."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, create_model

from beamtouch_service.record.database.errors import UnreadableRowError
from beamtouch_service.record.database.values import Unreadable

Version = Annotated[int, Field(ge=1)]
"""How often a row was written."""
_STRICT = ConfigDict(strict=True, allow_inf_nan=False, protected_namespaces=())
_MOST_QUOTED = 40
"""Characters of a damaged value that a message quotes."""


class Rows:
    """The rows of a table."""

    def __init__(self, table: str, columns: Mapping[str, Any]) -> None:
        """Check these columns of a table, as far as they are read. `columns`: name -> type of its values."""
        self._table = table
        members: dict[str, Any] = {name: (kind, None) for name, kind in columns.items()}
        row: type[BaseModel] = create_model(table, __config__=_STRICT, **members)
        # Each row is checked, and `model_validate` of the model takes twice as long.
        self._check = TypeAdapter(row).validator.validate_python

    def find_damage(self, what: str, values: Mapping[str, object]) -> str:
        """Return the damage of the row of `what`, in one line; empty if there is none."""
        try:
            self._check(values)
        except ValidationError as error:
            flaw = error.errors()[0]
            found = flaw["input"]
            quoted = f"{flaw['msg']}, not {str(found)[:_MOST_QUOTED]!r}"
            reason = found.reason if isinstance(found, Unreadable) else quoted
            return f"{what} cannot be read: table {self._table}, column {flaw['loc'][0]}: {reason}"
        return ""

    def require_whole(self, what: str, values: Mapping[str, object]) -> None:
        """Raise UnreadableRowError if the row of `what` is damaged."""
        if damage := self.find_damage(what, values):
            raise UnreadableRowError(damage)
