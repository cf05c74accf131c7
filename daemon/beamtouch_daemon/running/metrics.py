"""Counts and ages of all surfaces for Prometheus, on a loopback port.

The final summary needs the same counts, so the workers keep them, and a collector of prometheus_client reads them.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from beamtouch_common.errors import InputError
from beamtouch_daemon.running.surface_worker import SurfaceWorker

LOOPBACK = "127.0.0.1"

Workers = Callable[[], Iterable[SurfaceWorker]]
"""Returns the workers that run now."""
Spooled = Callable[[], Mapping[str, int]]
"""Returns the samples in the spool of surfaces without a worker, by surface."""


class WorkerCollector(Collector):
    """Reads the workers' counts on request, in the thread of the metrics server."""

    def __init__(self, workers: Workers, spooled_elsewhere: Spooled) -> None:
        self._workers = workers
        self._spooled_elsewhere = spooled_elsewhere

    def collect(self) -> Iterator[Metric]:
        """Return all metrics of all surfaces."""
        readings = CounterMetricFamily("beamtouch_readings", "Readings taken.", labels=["surface"])
        lost = CounterMetricFamily("beamtouch_readings_lost", "Readings due but not taken.", labels=["surface"])
        published = CounterMetricFamily("beamtouch_samples_published", "Samples acknowledged.", labels=["surface"])
        dropped = CounterMetricFamily("beamtouch_samples_dropped", "Samples that never arrive.", labels=["surface"])
        aside = CounterMetricFamily(
            "beamtouch_samples_set_aside", "Samples kept on disk that cannot be delivered.", labels=["surface"]
        )
        waiting = GaugeMetricFamily(
            "beamtouch_samples_waiting", "Samples not yet delivered.", labels=["surface", "where"]
        )
        age = GaugeMetricFamily("beamtouch_reading_age_seconds", "Age of the newest reading.", labels=["surface"])
        measured = GaugeMetricFamily(
            "beamtouch_readings_per_second", "Measured rate of the readings.", labels=["surface"]
        )
        wrong = GaugeMetricFamily(
            "beamtouch_rate_wrong", "1 while the measured rate is not the configured one.", labels=["surface"]
        )
        for worker in list(self._workers()):
            surface, counts = [worker.name], worker.summary()
            readings.add_metric(surface, counts.readings)
            lost.add_metric(surface, counts.readings_lost)
            published.add_metric(surface, counts.samples_published)
            dropped.add_metric(surface, counts.samples_dropped)
            aside.add_metric(surface, counts.samples_set_aside)
            waiting.add_metric([worker.name, "memory"], len(worker.outbox))
            waiting.add_metric([worker.name, "disk"], counts.samples_spooled)
            if (age_s := worker.age_s()) is not None:
                age.add_metric(surface, age_s)
            meter = worker.acquisition.meter
            if (measured_hz := meter.measured_hz) is not None:
                measured.add_metric(surface, measured_hz)
            wrong.add_metric(surface, 0 if meter.fits else 1)
        for name, samples in self._spooled_elsewhere().items():
            waiting.add_metric([name, "disk"], samples)
        yield from (readings, lost, published, dropped, aside, waiting, age, measured, wrong)


@contextmanager
def served(port: int | None, workers: Workers, spooled_elsewhere: Spooled) -> Iterator[None]:
    """Answer GET /metrics on a loopback port during the block; without a port, do nothing.

    Raises
    ------
    InputError
        The port cannot be used.
    """
    if port is None:
        yield
        return
    registry = CollectorRegistry()
    registry.register(WorkerCollector(workers, spooled_elsewhere))
    try:
        server, thread = start_http_server(port, LOOPBACK, registry)
    except OSError as error:
        message = f"metrics.port: cannot listen on {LOOPBACK}:{port} ({error.strerror}); choose another port"
        raise InputError(message) from error
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
