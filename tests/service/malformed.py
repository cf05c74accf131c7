"""Bodies of batches that no service may take."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

from service.conftest import batch_of

if TYPE_CHECKING:
    import random

STRANGE: list[Any] = [
    *(None, True, "", "x" * 1000, -1, 2**53, 2**64, 10**400, 1e308, -0.5, math.nan, math.inf, -math.inf),
    *([], {}, [[]], {"a": {}}, [None] * 100, "\ud800", "\0"),
]


def malformed(chance: random.Random) -> bytes:
    """Return a body that no service may take."""
    body = batch_of(sequence=1 + chance.randrange(1000))
    kind = chance.randrange(8)
    if kind == 0:
        del body[chance.choice(list(body))]
    elif kind == 1:
        body[chance.choice(["boot_id", "channels", "newest_age_ms", "samples"])] = chance.choice(STRANGE)
        body["samples"] = body["samples"] or [None]  # none at all is a question
    elif kind == 2:
        key = chance.choice(["sequence", "acquired_unix_us", "deflection_mm", "quality"])
        body["samples"][0][key] = chance.choice(STRANGE)
    elif kind == 3:
        body["channels"] = chance.choice([["s1"], ["a", "b", "c"], ["s1", "s1", "s2"], ["s1", "s2", "s3", "s4"]])
    elif kind == 4:
        body["samples"] *= 2  # the same number twice
    elif kind == 5:
        depth = chance.choice([10, 1000, 100_000])
        return b"[" * depth + b"]" * depth
    elif kind == 6:
        text = json.dumps(body).encode()
        return text[: chance.randrange(len(text))]
    else:
        return chance.randbytes(chance.randrange(2000))
    return json.dumps(body).encode()
