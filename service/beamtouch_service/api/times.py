"""Times in query parameters."""

from datetime import datetime
from typing import Annotated

from pydantic import AwareDatetime, BeforeValidator


def _rfc3339(value: object) -> object:
    # pydantic takes a bare number for seconds since 1970, or for milliseconds if it is large.
    if isinstance(value, str) and "T" not in value.upper():
        message = "expected a time such as 2026-11-20T23:40:46Z"
        raise ValueError(message)
    return value


Time = Annotated[AwareDatetime, BeforeValidator(_rfc3339)]
"""A time with its zone (RFC 3339)."""


def microseconds(moment: datetime | None) -> int | None:
    """Return a time in microseconds since 1970."""
    return None if moment is None else round(moment.timestamp() * 1e6)
