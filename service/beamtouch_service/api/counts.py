"""Counters and histograms of the service, and rate-limited log lines about what they count."""

import logging
from collections.abc import Callable
from time import monotonic, time

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, disable_created_metrics

from beamtouch_common.log import Repeated
from beamtouch_common.spans import apart, are_apart
from beamtouch_models.runtime import State
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.contact import rfc3339
from beamtouch_service.surfaces.surface import Surface

REFUSALS = frozenset({Kind.UNAUTHORIZED, Kind.FORBIDDEN, Kind.OTHER_NAME})
"""Requests that were refused for their token, or for the name that they ask for."""

_OUT = {
    Quality.MISSING: ("missing", "check its cable, its supply and its module"),
    Quality.STUCK: ("stuck", "its counts do not change: check its cable and the sensor"),
    Quality.SATURATED: (
        "saturated",
        "its counts stand at the end of the ADC: check its wiring, its supply and its gap",
    ),
    Quality.OUT_OF_RANGE: ("out of range", "check whether the sensor has moved, or something lies on the beam"),
}
"""How a channel is out, and what to look at."""

_INFERENCE_S = (10e-6, 20e-6, 50e-6, 100e-6, 200e-6, 500e-6, 1e-3, 2e-3, 5e-3, 10e-3)
_BATCH_S = (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 0.1, 0.2, 0.5, 1.0, 10.0)
"""Bounds [s] from a sample on loopback to the longest time that a body may take."""
_AGE_S = (1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Bounds [s] around sensible limits of age."""

_log = logging.getLogger(__name__)
# Each counter would otherwise have a second series with the time of its creation.
disable_created_metrics()  # type: ignore[no-untyped-call]  # the library's


def clock_ahead_s(surface: Surface, now_s: float) -> float | None:
    """Return how far the clock of the sender is ahead of that of this machine at `now_s` [s]; None if it is not known.

    `now_s` is the time by the clock that ages are counted with.
    """
    view = surface.view(now_s)
    newest = view.newest
    if newest is None or not view.is_current:
        return None
    return newest.sample.acquired_unix_us / 1e6 - (time() - (now_s - newest.acquired_s))


class Counts:
    """Counts since the start of one application."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self.registry = CollectorRegistry()
        self._counters: dict[str, Counter] = {}
        self._gauges: dict[str, Gauge] = {}
        self.contacts = self.counter("contacts", "Contacts served.", "surface", "state")
        self.rejected = self.counter("batches_rejected", "Batches that changed nothing.", "surface", "kind")
        """`surface` is empty where no surface has the name: a label must not hold what a client makes up."""
        self.batch_s = self._histogram("batch", "Time from the head of a batch to its receipt.", _BATCH_S)
        self._problems = self.counter("problems", "Answers that were a problem.", "kind")
        self._refusals = self.counter(
            "refusals", "Requests refused for their token, or for the name that they ask for.", "kind"
        )
        self._inference_s = self._histogram("inference", "Time per estimate.", _INFERENCE_S)
        self._age_s = self._histogram("sample_arrival_age", "Age of the newest sample at its arrival.", _AGE_S)
        for kind in REFUSALS:
            # An alarm cannot watch a series that does not exist yet.
            self._refusals.labels(kind.slug)
        self._minutely, self._hourly = Repeated(_log, clock=clock), Repeated(_log, every_s=3600.0, clock=clock)
        self._duplicated: set[str] = set()
        """Surfaces with two daemons, as it was logged."""
        self._findings: dict[str, str | None] = {}
        """Finding on the wiring of each surface, as it was logged."""
        self._sender_changes: dict[str, int] = {}

    def watch(self, surface: Surface) -> None:
        """Measure how long this surface takes, and start its counts at zero."""
        surface.runs.add(self._inference_s.labels(surface.name).observe)
        surface.arrivals.add(self._age_s.labels(surface.name).observe)
        self.batch_s.labels(surface.name)
        for state in State:
            self.contacts.labels(surface.name, state.value)

    def log_changes(self, surface: Surface, now_s: float) -> None:
        """Log what is new about a surface and its senders at `now_s` [s]."""
        self._sender_change(surface)
        self._unexplained(surface)
        self._wiring(surface)
        self._channels_out(surface)
        self._duplicate_senders(surface, now_s)
        self._clocks(surface, now_s)

    def other_beam(self, surface: str, detail: str) -> None:
        """Log that the samples of a surface are of another beam than its model, once per minute and surface."""
        if self._minutely.due(f"beam of {surface}"):
            _log.error("surface %s: its samples are refused: %s", surface, detail)

    def _sender_change(self, surface: Surface) -> None:
        """Log that another sender sends the samples of a surface, once per minute and surface."""
        changes, name = surface.sender_changes, surface.name
        if not surface.newest or self._sender_changes.get(name, 0) == changes:
            return
        self._sender_changes[name] = changes
        if times := self._minutely.due(f"sender of {name}"):
            words = "surface %s: the sender changed to %s (changes since the last line: %d)"
            _log.info(words, name, surface.newest.boot_id, times)

    def _unexplained(self, surface: Surface) -> None:
        """Log a stretch that lasts too long, once per stretch."""
        overdue = surface.unexplained.take_overdue()
        if overdue is None:
            return
        look = "look for a second load, for anything that touches the beam from below, for swapped cables, and for a "
        look += "damaged sensor"
        if overdue.suspect:
            look = f"check sensor {overdue.suspect}: without it, everything is explained"
        if overdue.shift_mm is not None:
            look = (
                f"all zeros have moved together by {1e3 * overdue.shift_mm:+.3g} um, as in warmth: wait until the "
                "surface no longer warms or cools, take everything off it, then tare"
            )
        if surface.wiring:
            look = f"{surface.wiring}; check the wiring, and the order in the daemon's config"
        words = "surface %s: since %s neither rest nor a single contact explains the samples (over %g s); %s"
        _log.warning(words, surface.name, rfc3339(overdue.since_us), surface.unexplained.after_s, look)

    def _wiring(self, surface: Surface) -> None:
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

    def _channels_out(self, surface: Surface) -> None:
        """Log the channels that went out, and those that are back, once each."""
        for name, out, is_back in surface.channels_out.take_transitions():
            if is_back:
                words = "surface %s: channel %s is good again; it had been out since %s"
                _log.info(words, surface.name, name, out.since)
            else:
                word, advice = _OUT[out.quality]
                words = "surface %s: channel %s has been %s since %s (over %g s); %s"
                _log.warning(words, surface.name, name, word, out.since, surface.channels_out.after_s, advice)

    def _duplicate_senders(self, surface: Surface, now_s: float) -> None:
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

    def _clocks(self, surface: Surface, now_s: float) -> None:
        """Log that a daemon has another clock than this machine at `now_s` [s]: once an hour."""
        ahead_s = clock_ahead_s(surface, now_s)
        if ahead_s is None or not are_apart(ahead_s) or not self._hourly.due(f"clock of {surface.name}"):
            return
        words = "surface %s: the clock of its daemon is %s that of this machine; events have the time of the daemon"
        _log.warning(words, surface.name, apart(ahead_s))

    def problem(self, kind: Kind, client: str) -> None:
        """Count a problem that was answered to this address; log a refusal once per minute and kind."""
        self._problems.labels(kind.slug).inc()
        if kind not in REFUSALS:
            return
        self._refusals.labels(kind.slug).inc()
        if times := self._minutely.due(kind.slug):
            _log.warning("refused (%s): %d since the last such line, the newest from %s", kind.slug, times, client)

    def counter(self, name: str, words: str, *labels: str) -> Counter:
        """Return the counter of this name. An output that is begun again goes on with the one that it had."""
        if name not in self._counters:
            self._counters[name] = Counter(f"beamtouch_{name}", words, labels, registry=self.registry)
        return self._counters[name]

    def gauge(self, name: str, words: str) -> Gauge:
        """Return the gauge of this name, likewise."""
        if name not in self._gauges:
            self._gauges[name] = Gauge(f"beamtouch_{name}", words, registry=self.registry)
        return self._gauges[name]

    def _histogram(self, name: str, words: str, buckets_s: tuple[float, ...]) -> Histogram:
        return Histogram(f"beamtouch_{name}_seconds", words, ["surface"], registry=self.registry, buckets=buckets_s)
