"""The log of what changes about surfaces and their senders, and of refused and failed requests, limited in rate."""

import logging
from collections.abc import Callable
from time import monotonic
from traceback import extract_tb

from beamtouch_common.log_lines import Repeated
from beamtouch_common.outline import kind_of
from beamtouch_common.spans import apart, are_apart
from beamtouch_common.units import MM, fine
from beamtouch_service.metrics.counts import REFUSALS
from beamtouch_service.metrics.figures import clock_ahead_s
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.contact import rfc3339
from beamtouch_service.surfaces.surface import Surface

_OUT = {
    Quality.MISSING: ("missing", "check its cable, its supply and its module"),
    Quality.STUCK: ("stuck", "its counts do not change: check its cable and the sensor"),
    Quality.SATURATED: (
        "saturated",
        "its counts stand at the end of the ADC: check its wiring, its supply and its gap",
    ),
    Quality.OUT_OF_RANGE: ("out of range", "check whether the sensor has moved, or something lies on the {kind}"),
}
"""Words for the way in which a channel of a beam or a plate, its `kind`, is out, and what to look at."""

_log = logging.getLogger(__name__)


class ChangeLog:
    """The log of one application: it knows what it has said of each surface."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._minutely, self._hourly = Repeated(_log, clock=clock), Repeated(_log, every_s=3600.0, clock=clock)
        self._duplicated: set[str] = set()
        """Surfaces with two daemons, as it was logged."""
        self._findings: dict[str, str | None] = {}
        """Finding on the wiring of each surface, as it was logged."""
        self._sender_changes: dict[str, int] = {}

    def log_failure(self, error: Exception) -> None:
        """Log an unexpected error that ended a request, with its traceback, once per minute and line that raised it."""
        # Not by its words: a client may choose those.
        places = [f"{one.filename}:{one.lineno}" for one in extract_tb(error.__traceback__)[-1:]]
        if line := self._minutely.line_if_due("an error ended a request", f"{type(error).__name__} {places}"):
            _log.error("%s", line, exc_info=error)

    def log_changes(self, surface: Surface, now_s: float) -> None:
        """Log what is new about a surface and its senders at `now_s` [s]."""
        self._log_sender(surface)
        self._log_unexplained(surface)
        self._log_wiring(surface)
        self._log_channels(surface)
        self._log_duplicate_senders(surface, now_s)
        self._log_clock(surface, now_s)

    def log_other_beam(self, surface: str, detail: str) -> None:
        """Log that the samples of a surface are of another beam than its model, once per minute and surface."""
        if self._minutely.due(f"beam of {surface}"):
            _log.error("surface %s: its samples are refused: %s", surface, detail)

    def _log_sender(self, surface: Surface) -> None:
        """Log that another sender sends the samples of a surface, once per minute and surface."""
        changes, name = surface.sender_changes, surface.name
        if not surface.newest or self._sender_changes.get(name, 0) == changes:
            return
        self._sender_changes[name] = changes
        if times := self._minutely.due(f"sender of {name}"):
            words = "surface %s: the sender changed to %s (changes since the last line: %d)"
            _log.info(words, name, surface.newest.boot_id, times)

    def _log_unexplained(self, surface: Surface) -> None:
        """Log a stretch that lasts too long, once per stretch."""
        overdue = surface.unexplained.take_overdue()
        if overdue is None:
            return
        look = (
            f"look for a second load, for anything that touches the {kind_of(surface.axes)} from below, for swapped "
            "cables, and for a damaged sensor"
        )
        if overdue.suspect:
            look = f"check sensor {overdue.suspect}: without it, everything is explained"
        if overdue.shift_mm is not None:
            unit = surface.model.metadata.unit if surface.model else MM
            sign = "+" if overdue.shift_mm > 0 else ""
            look = (
                f"all zeros have moved together by {sign}{fine(overdue.shift_mm, unit)}, as in warmth: wait until the "
                "surface no longer warms or cools, take everything off it, then tare"
            )
        if surface.wiring:
            look = f"{surface.wiring}; check the wiring, and the order in the daemon's config"
        words = "surface %s: since %s neither rest nor a single contact explains the samples (over %g s); %s"
        _log.warning(words, surface.name, rfc3339(overdue.since_us), surface.unexplained.after_s, look)

    def _log_wiring(self, surface: Surface) -> None:
        """Log a finding on the wiring once, and that it holds no longer."""
        before, found = self._findings.get(surface.name), surface.wiring
        if found == before:
            return
        self._findings[surface.name] = found
        if found:
            advice = "that explains its last contacts; check the wiring, and the order in the daemon's config"
            _log.warning("surface %s: %s; %s", surface.name, found, advice)
        else:
            _log.info("surface %s: the wiring seems to be right again", surface.name)

    def _log_channels(self, surface: Surface) -> None:
        """Log the channels that went out, and those that are back, once each."""
        for name, out, is_back in surface.channels_out.take_transitions():
            if is_back:
                words = "surface %s: channel %s is good again; it had been out since %s"
                _log.info(words, surface.name, name, out.since)
            else:
                word, advice = _OUT[out.quality]
                advice = advice.format(kind=kind_of(surface.axes))
                words = "surface %s: channel %s has been %s since %s (over %g s); %s"
                _log.warning(words, surface.name, name, word, out.since, surface.channels_out.after_s, advice)

    def _log_duplicate_senders(self, surface: Surface, now_s: float) -> None:
        """Log that two daemons send samples at `now_s` [s]: at once, then once an hour; and that one does again."""
        pair = surface.duplicate_senders.at(now_s)
        if pair is None:
            if surface.name in self._duplicated:
                self._duplicated.discard(surface.name)
                _log.info("surface %s: one daemon sends its samples again", surface.name)
        elif self._hourly.due(surface.name):
            self._duplicated.add(surface.name)
            words = "surface %s: two daemons send its samples, from %s and from %s; stop one of them"
            _log.warning(words, surface.name, *pair)

    def _log_clock(self, surface: Surface, now_s: float) -> None:
        """Log that a daemon has another clock than this machine at `now_s` [s]: once an hour."""
        ahead_s = clock_ahead_s(surface, now_s)
        if ahead_s is None or not are_apart(ahead_s) or not self._hourly.due(f"clock of {surface.name}"):
            return
        words = "surface %s: the clock of its daemon is %s that of this machine; events have the time of the daemon"
        _log.warning(words, surface.name, apart(ahead_s))

    def log_refusal(self, kind: Kind, client: str) -> None:
        """Log that a request from this address was refused, once per minute and kind; nothing for other problems."""
        if kind in REFUSALS and (times := self._minutely.due(kind.slug)):
            _log.warning("refused (%s): %d since the last such line, the newest from %s", kind.slug, times, client)
