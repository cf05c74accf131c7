"""The health of one surface under one model, from the best samples of its events. One thread at a time."""

import logging
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from beamtouch_common.units import MM
from beamtouch_models.runtime import BestSample, ChannelChange, Health, ModelFile
from beamtouch_service.record.events.best import Best
from beamtouch_service.record.events.times import latest_us
from beamtouch_service.surfaces.channels import ChannelHealth, Part, SurfaceHealth
from beamtouch_service.surfaces.contact import rfc3339

_PERCENT_DIGITS, _MM_DIGITS = 3, 6
_log = logging.getLogger(__name__)


BlockKey = tuple[int, int]
"""Time of the first contact of a block [us since 1970], and the number of the block among those of this time."""


@dataclass(frozen=True)
class StoredHealth:
    """The health of a surface as it is on record."""

    version: int = 0
    """How often it was written."""
    model: str = ""
    characteristic: str | None = None
    newest_us: int = 0
    blocks: Mapping[BlockKey, list[Any]] = field(default_factory=dict)
    """Blocks of contacts, as JSON. A contact changes two or three of a hundred, and only these are written."""
    damage: str = ""
    """Why it cannot be read, in one line; empty if it can. What is damaged is there to be replaced."""

    def history(self) -> dict[str, Any]:
        """Return the blocks as `Health` takes them."""
        return {"blocks": [[first_us, *block] for (first_us, _), block in sorted(self.blocks.items())]}


class HealthHistory:
    """Sums of the best samples of a surface since its baseline began."""

    def __init__(self, surface: str, model: ModelFile, stored: StoredHealth) -> None:
        """Go on from what is on record, if the same model made it."""
        self._surface, self.model = surface, model
        self.stored = stored
        """The durable sums."""
        self.next: StoredHealth | None = None
        """The sums that are to become durable; None if all are."""
        self.starts_over_because = stored.damage
        """Why what is on record cannot be gone on from, though the same model may have made it; else empty."""
        self._begin()
        if stored.model == model.identity and not stored.damage:
            try:
                self._health = Health(model.metadata, stored.history())
                self._characteristic, self._newest_us = stored.characteristic, stored.newest_us
            except ValueError as error:
                self.starts_over_because = str(error)
        self.state = self._describe()
        """The health so far."""

    def _begin(self, characteristic: str | None = None, newest_us: int = 0) -> None:
        self._health = Health(self.model.metadata)
        self._characteristic = characteristic
        self._newest_us = newest_us
        """Time of the newest sample so far."""

    def add(self, samples: list[Best]) -> None:
        """Add best samples. Another characteristic begins a new baseline; a late sample from before it is left out."""
        added: list[BestSample] = []
        for best in samples:
            if best.channels != self.model.channels:
                continue
            if best.characteristic != self._characteristic or not (added or self._health.contacts):
                if self._is_late(best):
                    continue
                if self._health.contacts or added:
                    words = "surface %s: another characteristic or tare; the health of its sensors starts over"
                    _log.info(words, self._surface)
                self._begin(best.characteristic, self._newest_us)
                added = []
            self._newest_us = max(self._newest_us, best.at_us)
            if best.rest_mm is None:
                continue  # a gain is judged only where the zeros are known
            values = best.deflection_mm, best.deviation_mm, best.rest_mm, best.rest_deviation_mm
            added.append(BestSample(best.at_us, *values, best.is_contact))
        self._health.add(added)
        self.state = self._describe()
        if added:
            self.next = self._to_store()

    def _to_store(self) -> StoredHealth:
        blocks, at = dict[BlockKey, list[Any]](), Counter[int]()
        for first_us, *block in self._health.to_json()["blocks"]:
            blocks[first_us, at[first_us]] = block
            at[first_us] += 1
        version, identity = self.stored.version + 1, self.model.identity
        return StoredHealth(version, identity, self._characteristic, self._newest_us, blocks)

    def _is_late(self, best: Best) -> bool:
        """Return whether a sample is from before the newest one, whose own time counts only if it can be true."""
        if self._newest_us > latest_us(time.time()):
            self._newest_us = 0  # of a clock that was wrong: it would make all samples late for years
        return best.at_us < self._newest_us

    def _describe(self) -> SurfaceHealth:
        unit, of_channels = self.model.metadata.unit, self._health.channels()
        channels = zip(self.model.channels, of_channels, strict=False)  # none before the first contact
        return SurfaceHealth(self.model.identity, {name: _channel_health(change, unit) for name, change in channels})


def _channel_health(change: ChannelChange, unit: str) -> ChannelHealth:
    gain, zero = change.gain, change.zero
    percent = [round(100 * value, _PERCENT_DIGITS) for value in (gain.value, gain.low, gain.high)]
    mm = [_rounded(value, unit) for value in (zero.value, zero.low, zero.high)] if zero else [None] * 3
    changes = [part for part, one in ((Part.GAIN, gain), (Part.ZERO, zero)) if one and one.changed]
    return ChannelHealth(
        gain_percent=percent[0],
        gain_low_percent=percent[1],
        gain_high_percent=percent[2],
        zero_mm=mm[0],
        zero_low_mm=mm[1],
        zero_high_mm=mm[2],
        unit=unit,
        since=rfc3339(change.since_us),
        contacts=change.contacts,
        changed=bool(changes),
        changes=changes,
    )


def _rounded(value: float, unit: str) -> float:
    """Return a zero: to a nanometre if it is in mm, to digits that no sensor has in another unit."""
    return round(value, _MM_DIGITS) if unit == MM else float(f"{value:.{_MM_DIGITS}g}")
