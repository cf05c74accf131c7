"""Times in the addresses of requests (RFC 3339)."""

import re
from datetime import datetime
from typing import Annotated

from pydantic import AwareDatetime, BeforeValidator

_LOST_PLUS = re.compile(r"(?i).*T.* \d\d:?\d\d")
"""A time with its zone, of which the query has made the + a space."""


def _require_rfc3339(value: object) -> object:
    # pydantic takes a bare number for seconds since 1970, or for milliseconds if it is large.
    if isinstance(value, str) and "T" not in value.upper():
        raise ValueError("expected a time such as 2026-11-20T23:40:46Z")
    if isinstance(value, str) and _LOST_PLUS.fullmatch(value):
        escaped = value.replace(" ", "%2B")
        raise ValueError(f"in an address, + means a space; write {escaped}, or the time in UTC with Z at its end")
    return value


Time = Annotated[AwareDatetime, BeforeValidator(_require_rfc3339)]
"""A time with its zone (RFC 3339)."""


def microseconds(moment: datetime | None) -> int | None:
    """Return a time in microseconds since 1970."""
    return None if moment is None else round(moment.timestamp() * 1e6)
