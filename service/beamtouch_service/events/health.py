"""The health of surfaces, from the best samples of their events. One thread at a time."""

import logging
import time
from dataclasses import dataclass

from beamtouch_models.modelfile import BestSample, ChannelChange, Health, ModelFile
from beamtouch_service.events.best import Best
from beamtouch_service.events.store import KeptHealth, Sampled, Store
from beamtouch_service.surfaces.contact import rfc3339
from beamtouch_service.surfaces.health import ChannelHealth, Part, SurfaceHealth
from beamtouch_service.surfaces.surface import Surface

READ_AT_ONCE = 64
"""Events read at once."""
SAVE_S = 60.0
"""Time between two writes of a baseline; after a crash the events since the last one are read again."""
_PERCENT_DIGITS, _MM_DIGITS = 3, 6

_log = logging.getLogger("beamtouch.service.events")


@dataclass
class _Kept:
    """The baseline of one surface, in memory."""

    model: ModelFile
    health: Health
    characteristic: str | None = None
    last_event: int = 0
    newest_us: int = 0
    saved_event: int = 0
    saved_s: float = float("-inf")


class HealthKeeper:
    """Follows the events of all surfaces."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._kept: dict[str, _Kept] = {}

    def update(self, surface: Surface) -> bool:
        """Read the next events of a surface and state its health; return whether there are more to read."""
        kept = self._of_model(surface)
        if kept is None:
            return False
        found = self._store.ended_after(surface.name, kept.last_event, READ_AT_ONCE)
        if found:
            self._take(surface.name, kept, found)
            kept.last_event = found[-1].number
        if kept.last_event != kept.saved_event and time.monotonic() - kept.saved_s >= SAVE_S:
            self._save(surface.name, kept)
        surface.health = _stated(kept)
        return len(found) == READ_AT_ONCE

    def close(self) -> None:
        """Write the baselines that changed since the last write."""
        for name, kept in self._kept.items():
            if kept.last_event != kept.saved_event:
                self._save(name, kept)

    def _of_model(self, surface: Surface) -> _Kept | None:
        """Return the baseline of the model in use; None if nothing can be said with it."""
        model, kept = surface.model, self._kept.get(surface.name)
        if model is None or model.metadata.influence is None:
            return None
        if kept is None or kept.model.identity != model.identity:
            kept = self._kept[surface.name] = self._loaded(surface.name, model, kept)
        return kept

    def _loaded(self, surface: str, model: ModelFile, before: _Kept | None) -> _Kept:
        """Return the baseline on record, or a new one; `before` is that of the model before."""
        found = self._store.health(surface)
        if found is not None and found.model == model.identity:
            try:
                health = Health(model.metadata, found.history)
            except ValueError as error:
                _log.warning("surface %s: its health begins anew: %s", surface, error)
            else:
                last = found.last_event
                return _Kept(model, health, found.characteristic, last, found.newest_us, last, time.monotonic())
        return _Kept(model, Health(model.metadata), last_event=before.last_event if before else 0)

    def _take(self, surface: str, kept: _Kept, found: list[Sampled]) -> None:
        """Add best samples. Another characteristic begins a new baseline; what came late from before it is left out."""
        added: list[BestSample] = []
        for one in found:
            best = one.best
            if best is None or one.model != kept.model.identity or best.channels != kept.model.channels:
                continue
            if best.characteristic != kept.characteristic or not (added or kept.health.contacts):
                if best.at_us < kept.newest_us:
                    continue
                if kept.health.contacts or added:
                    _log.info(
                        "surface %s: another characteristic or tare; the health of its sensors begins anew", surface
                    )
                kept.health, kept.characteristic, added = Health(kept.model.metadata), best.characteristic, []
            kept.newest_us = max(kept.newest_us, best.at_us)
            added.append(_sample(best))
        kept.health.add(added)

    def _save(self, surface: str, kept: _Kept) -> None:
        history, identity = kept.health.to_json(), kept.model.identity
        self._store.keep_health(
            KeptHealth(surface, identity, kept.characteristic, kept.last_event, kept.newest_us, history)
        )
        kept.saved_event, kept.saved_s = kept.last_event, time.monotonic()


def _sample(best: Best) -> BestSample:
    return BestSample(
        best.at_us, best.deflection_mm, best.deviation_mm, best.rest_mm, best.rest_deviation_mm, best.is_contact
    )


def _stated(kept: _Kept) -> SurfaceHealth:
    channels = zip(kept.model.channels, kept.health.channels(), strict=False)  # none before the first contact
    return SurfaceHealth(model=kept.model.identity, channels={name: _channel(one) for name, one in channels})


def _channel(found: ChannelChange) -> ChannelHealth:
    gain, zero = found.gain, found.zero
    percent = [round(100 * value, _PERCENT_DIGITS) for value in (gain.value, gain.low, gain.high)]
    mm = [round(value, _MM_DIGITS) for value in (zero.value, zero.low, zero.high)] if zero else [None] * 3
    changes = [part for part, one in ((Part.GAIN, gain), (Part.ZERO, zero)) if one and one.changed]
    return ChannelHealth(
        gain_percent=percent[0],
        gain_low_percent=percent[1],
        gain_high_percent=percent[2],
        zero_mm=mm[0],
        zero_low_mm=mm[1],
        zero_high_mm=mm[2],
        since=rfc3339(found.since_us),
        contacts=found.contacts,
        changed=bool(changes),
        changes=changes,
    )
