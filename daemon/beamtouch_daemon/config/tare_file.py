"""The tare file: the rest gaps that `tare` measured, in a small JSON file beside the configuration."""

import hashlib
import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from beamtouch_common.encodings import decode
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import read_bounded, write_atomically
from beamtouch_daemon.config.signal import Channel
from beamtouch_service.samples import TARED_AT, ChannelName, SurfaceName

MODE = 0o644
"""Permissions: the user of the service reads what root measured, whatever the umask of root."""

DIGITS = 8
"""Digits of the identity of a characteristic."""

NOT_TARED = (
    "not tared: the rest gaps are those of the configuration; run beamtouch-daemon tare, with nothing on the beam"
)
"""Message about a surface without a tare file."""


class TareFile(BaseModel):
    """Content of the file."""

    model_config = ConfigDict(extra="forbid", strict=True)

    surface: SurfaceName
    taken_at: str
    """UTC, ISO 8601."""
    readings: int
    """Number of readings in the mean."""
    rest_gap_mm: dict[ChannelName, FiniteFloat]
    characteristic: dict[ChannelName, str] = Field(default_factory=dict)
    """Identity of the characteristic that each was measured with."""

    def other_characteristics(self, channels: Sequence[Channel]) -> list[str]:
        """Return the channels whose characteristic is another one than at the tare."""
        now = _identities(channels)
        return [name for name, before in self.characteristic.items() if now.get(name, before) != before]

    @property
    def stated_time(self) -> str | None:
        """The time of the tare, as a batch states it; None if the file was changed to have none."""
        return self.taken_at if re.fullmatch(TARED_AT, self.taken_at) else None

    def age_s(self, now: datetime) -> float:
        """Return the time since the tare; infinite if the file does not say, or the clock is before it."""
        try:
            taken_at = datetime.fromisoformat(self.taken_at)
        except ValueError:
            return math.inf
        age_s = (now - taken_at.replace(tzinfo=taken_at.tzinfo or UTC)).total_seconds()
        return age_s if age_s >= 0 else math.inf


def save(path: Path, surface: str, readings: int, rest_gap_mm: dict[str, float], channels: Sequence[Channel]) -> None:
    """Write a tare file whole or not at all; OSError if that is impossible."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    content = TareFile(
        surface=surface,
        taken_at=now,
        readings=readings,
        rest_gap_mm=rest_gap_mm,
        characteristic=_identities(channels),
    )
    write_atomically(path, (content.model_dump_json(indent=2) + "\n").encode(), mode=MODE)


def _identities(channels: Sequence[Channel]) -> dict[str, str]:
    """Return a short text for each channel that changes with its characteristic."""
    curves = {channel.name: repr((channel.points, channel.slopes)) for channel in channels}
    return {name: hashlib.sha256(curve.encode()).hexdigest()[:DIGITS] for name, curve in curves.items()}


def load(path: Path, channels: Sequence[str]) -> TareFile | None:
    """Return the content of a tare file; None without a file.

    InputError if the file cannot be used; FailedError if it cannot be read now.
    """
    try:
        content = TareFile.model_validate_json(decode(read_bounded(path)))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FailedError(f"{path}: {error.strerror}") from error
    except ValidationError as error:
        raise InputError(f"{path}: not a tare file; delete it or run beamtouch-daemon tare again") from error
    except ValueError as error:
        raise InputError(f"{path}: not a tare file: {error}; or run beamtouch-daemon tare again") from error
    if set(content.rest_gap_mm) != set(channels):
        raise InputError(f"{path}: made for other channels; delete it or run beamtouch-daemon tare again")
    return content
