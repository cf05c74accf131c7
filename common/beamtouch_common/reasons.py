"""What is wrong with a value, in plain words, for each type of pydantic's errors."""

import re
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any

from pydantic_core import ErrorDetails

from beamtouch_common.plain_toml import toml_of

_OWN = "Value error, "
"""Beginning of the messages of our own checks."""
_NOTHING: Mapping[str, Any] = MappingProxyType({})
_KINDS = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": "text in quotes",
    "path_type": "a path in quotes",
    "bool_type": "true or false",
    "tuple_type": "a list, as [1, 2]",
    "list_type": "a list, as [1, 2]",
    "dict_type": "a table, as { key = 1 }",
    "model_type": "a table, as { key = 1 }",
}
"""Types of errors that mean a value of another kind -> the kind that it must have."""
_LISTS = ("tuple_type", "list_type")
_TABLES = ("dict_type", "model_type")
_NUMBER = re.compile(r"(?<!\w)(?<!\d\.)-?\d+(?:\.\d+)?")
"""A number in a text, such as both of 2..20 and none of the later ones in 10.0.0.1."""


def reason_of(error: ErrorDetails, key: str = "", *, numeric: bool = False) -> str:
    """Return what is wrong with a value, without the key and the value.

    `key` names the table that it should be; `numeric`: whether a list in its place holds numbers.
    """
    kind, context = error["type"], error.get("ctx", _NOTHING)
    if kind == "literal_error":
        return f"must be {one_of(context['expected'], error['input'])}"
    if kind in _TABLES and key and not key.endswith("]"):
        several = f", not several, [[{key}]]" if isinstance(error["input"], list) else ""
        return f"must be one table, [{key}]{several}"
    if kind in _LISTS and isinstance(error["input"], str):
        return f"must be a list, as {_as_list(error['input'], numeric=numeric)}"
    if kind in _KINDS:
        return f"must be {_KINDS[kind]}"
    if kind in _WORDS:
        return _WORDS[kind](context)
    return re.sub(r"^\w+ should ", "must ", error["msg"].removeprefix(_OWN))


def _as_list(text: str, *, numeric: bool) -> str:
    """Return a list that a text may mean: of the numbers in it, or else of itself, unless it must hold numbers."""
    numbers = _NUMBER.findall(text)
    if len(numbers) > 1:
        return f"[{', '.join(numbers)}]"
    return "[1, 2]" if numeric else toml_of([text])


def is_of_another_kind(error: ErrorDetails) -> bool:
    """Return whether a value is not of the kind that it must have."""
    return error["type"] in _KINDS or error["type"] == "literal_error"


def one_of(expected: str, value: object) -> str:
    """Return what a value must be one of, with the one that it may mean; `expected` is as pydantic prints it."""
    names = re.findall(r"'([^']*)'", expected)
    if not names:
        return expected
    *before, last = [f'"{name}"' for name in names]
    text = f"{', '.join(before)} or {last}" if before else last
    near = get_close_matches(value, names, n=1) if isinstance(value, str) and before else []
    return f'{text}; did you mean "{near[0]}"?' if near else text


def _bound(words: str, name: str) -> Callable[[Mapping[str, Any]], str]:
    def reason(context: Mapping[str, Any]) -> str:
        limit = context[name]
        return f"must be {words} {int(limit) if limit == int(limit) else limit}"

    return reason


def _too_short(what: str) -> Callable[[Mapping[str, Any]], str]:
    def reason(context: Mapping[str, Any]) -> str:
        least = context["min_length"]
        return "must not be empty" if least == 1 else f"must have at least {least} {what}"

    return reason


_PATTERNS = {"^[A-Za-z0-9_.-]{1,64}$": 'have 1 to 64 letters, digits, "_", "." or "-"'}
"""Patterns in words."""
_WORDS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "greater_than": _bound("more than", "gt"),
    "greater_than_equal": _bound("at least", "ge"),
    "less_than": _bound("less than", "lt"),
    "less_than_equal": _bound("at most", "le"),
    "too_short": _too_short("entries"),
    "string_too_short": _too_short("characters"),
    "too_long": lambda context: f"must have at most {context['max_length']} entries",
    "string_too_long": lambda context: f"must have at most {context['max_length']} characters",
    "string_pattern_mismatch": lambda context: (
        f"must {_PATTERNS.get(context['pattern'], 'match the pattern ' + context['pattern'])}"
    ),
}
