"""Counters, gauges and histograms that the parts of the service keep."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, disable_created_metrics

from beamtouch_models.runtime import State
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.surface import Surface

REFUSALS = frozenset({Kind.UNAUTHORIZED, Kind.FORBIDDEN, Kind.OTHER_NAME})
"""Requests that were refused for their token, or for the name that they ask for."""

_INFERENCE_S = (10e-6, 20e-6, 50e-6, 100e-6, 200e-6, 500e-6, 1e-3, 2e-3, 5e-3, 10e-3)
_BATCH_S = (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 0.1, 0.2, 0.5, 1.0, 10.0)
"""Bounds [s] from a sample on loopback to the longest time that a body may take."""
_AGE_S = (1e-3, 2e-3, 5e-3, 10e-3, 20e-3, 50e-3, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Bounds [s] around sensible limits of age."""

# Each counter would otherwise have a second series with the time of its creation.
disable_created_metrics()  # type: ignore[no-untyped-call]  # the library's


class Counts:
    """Counts since the start of one application."""

    def __init__(self) -> None:
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

    def watch(self, surface: Surface) -> None:
        """Measure how long this surface takes, and start its counts at zero."""
        surface.runs.add(self._inference_s.labels(surface.name).observe)
        surface.arrivals.add(self._age_s.labels(surface.name).observe)
        self.batch_s.labels(surface.name)
        for state in State:
            self.contacts.labels(surface.name, state.value)

    def count_problem(self, kind: Kind) -> None:
        """Count a problem that was answered."""
        self._problems.labels(kind.slug).inc()
        if kind in REFUSALS:
            self._refusals.labels(kind.slug).inc()

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
