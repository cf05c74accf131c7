"""Values of columns. A damaged file may hold anything, and SQLite does not see it: it shows when a value is read.

A value does not know its row. So one that cannot be read becomes an `Unreadable`, which `rows` finds and names.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, TypedDict

from sqlalchemy import Dialect, String, TypeDecorator

from beamtouch_service.record.database.errors import reason_of


@dataclass(frozen=True)
class Unreadable:
    """A value that cannot be read, with the reason."""

    reason: str


def _read_json(text: str | bytes | float) -> object:
    """Return the value of a JSON column, or `Unreadable` if it is damaged."""
    try:
        # SQLite makes a number of a text that is one.
        return json.loads(text) if isinstance(text, str | bytes) else text
    except ValueError as error:
        return Unreadable(reason_of(error))


class _Json(TypedDict):
    json_serializer: Callable[[Any], str]
    json_deserializer: Callable[[str | bytes], Any]


JSON_CODEC: _Json = {
    "json_serializer": partial(json.dumps, separators=(",", ":"), allow_nan=False),
    "json_deserializer": _read_json,
}
"""Writes and reads the JSON columns of an engine."""


class Word(TypeDecorator[StrEnum]):
    """A column of the words of an enumeration."""

    impl = String
    cache_ok = True

    def __init__(self, words: type[StrEnum]) -> None:
        super().__init__(length=20)
        self.words = words

    def process_bind_param(self, value: StrEnum | None, dialect: Dialect) -> str | None:  # noqa: ARG002
        """Return the word to write."""
        return None if value is None else value.value

    def process_result_value(self, value: str | None, dialect: Dialect) -> Any:  # noqa: ANN401, ARG002
        """Return the member of a word that was read."""
        try:
            return None if value is None else self.words(value)
        except ValueError:
            return Unreadable(f"{value!r} is not among the defined enum values of {self.words.__name__}")
