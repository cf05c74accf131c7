"""Conversion between a batch and its row in the spool. A row that changed on the disk is detected, never delivered."""

import math
import re
import time
import zlib
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import Batch

MARGIN_S = 3600.0
"""A batch from before this boot counts as at least this much older than the boot."""
NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
"""Valid names of surfaces."""


class BadRowError(Exception):
    """The row no longer contains the batch that was written; the text says why."""


@dataclass(frozen=True, slots=True)
class Spooled:
    """A batch from the spool."""

    number: int
    batch: Batch
    """The batch as it was written. Its age was that of another moment."""
    newest_s: float
    """Time of its newest sample by the clock of `uptime_s` [s]."""


def row_of(surface: str, batch: Batch, machine_boot: str, newest_monotonic_s: float) -> tuple[Any, ...]:
    """Return the columns of a batch without its number, the checksum last."""
    content = batch.model_dump_json(exclude_defaults=True)
    row = (surface, len(batch.samples), machine_boot, newest_monotonic_s, content)
    return (*row, _checksum(surface.encode(), len(batch.samples), machine_boot.encode(), newest_monotonic_s, content))


def batch_of(row: tuple[Any, ...], number: int, this_boot: str) -> Spooled:
    """Return the batch in a row, texts as bytes.

    Raises
    ------
    BadRowError
        A value changed since it was written, or the content is not a batch.
    """
    surface, samples, machine_boot, newest_monotonic_s, content, checksum = row
    kinds = (bytes, int, bytes, float, bytes)
    if not all(isinstance(value, kind) for value, kind in zip(row[:5], kinds, strict=True)):
        message = "a column has the wrong type"
        raise BadRowError(message)
    # A row of an older version has no checksum; but its content is checked too.
    if checksum is not None and checksum != _checksum(
        surface, samples, machine_boot, newest_monotonic_s, content.decode(errors="surrogateescape")
    ):
        message = "the checksum does not match"
        raise BadRowError(message)
    try:
        batch = Batch.model_validate_json(content)
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=False, include_context=False)[0]
        message = f"the content is not a batch ({found['msg']})"
        raise BadRowError(message) from error
    if len(batch.samples) != samples or not NAME.fullmatch(surface.decode(errors="replace")):
        message = "the columns do not match the content"
        raise BadRowError(message)
    if machine_boot.decode(errors="replace") != this_boot:
        # From before this boot. Only the wall clock knows how old, and it may have been set since.
        stated_s = time.time() - batch.samples[-1].acquired_unix_us / 1e6
        now_s = uptime_s()
        newest_monotonic_s = now_s - max(stated_s, now_s + MARGIN_S)
    elif not math.isfinite(newest_monotonic_s) or newest_monotonic_s > uptime_s():
        message = "its time is not within this boot"
        raise BadRowError(message)
    return Spooled(number, batch, newest_monotonic_s)


def _checksum(surface: bytes, samples: int, machine_boot: bytes, newest_monotonic_s: float, content: str) -> int:
    head = f"{surface.hex()} {samples} {machine_boot.hex()} {newest_monotonic_s!r} "
    return zlib.crc32(head.encode() + content.encode(errors="surrogateescape"))
