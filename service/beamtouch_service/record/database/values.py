"""Values of columns. A damaged file may hold anything, and SQLite does not see it: it shows when a value is read."""

import json
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from typing import Any, TypedDict

from sqlalchemy import Dialect, String, TypeDecorator

from beamtouch_service.record.database.errors import UnreadableRowError, reason_of


def _read_json(text: str | bytes) -> Any:  # noqa: ANN401  # JSON
    """Return the value of a JSON column; raises UnreadableRowError."""
    try:
        return json.loads(text)
    except ValueError as error:
        raise UnreadableRowError(f"a row cannot be read: {reason_of(error)}") from None


class _Json(TypedDict):
    json_serializer: Callable[[Any], str]
    json_deserializer: Callable[[str | bytes], Any]


JSON_CODEC: _Json = {
    "json_serializer": partial(json.dumps, separators=(",", ":"), allow_nan=False),
    "json_deserializer": _read_json,
}
"""Writes and reads the JSON columns of an engine."""


class Word(TypeDecorator[StrEnum]):
    """A column of the words of an enumeration; to read another word raises UnreadableRowError."""

    impl = String
    cache_ok = True

    def __init__(self, words: type[StrEnum]) -> None:
        super().__init__(length=20)
        self.words = words

    def process_bind_param(self, value: StrEnum | None, dialect: Dialect) -> str | None:  # noqa: ARG002
        """Return the word to write."""
        return None if value is None else value.value

    def process_result_value(self, value: str | None, dialect: Dialect) -> StrEnum | None:  # noqa: ARG002
        """Return the member of a word that was read."""
        try:
            return None if value is None else self.words(value)
        except ValueError:
            reason = f"{value!r} is not among the defined enum values of {self.words.__name__}"
            raise UnreadableRowError(f"a row cannot be read: {reason}") from None
