"""Counts and ages of every line for Prometheus, on a loopback port, in the exposition format of its own library."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from beamtouch_daemon.config.settings import ConfigError
from beamtouch_daemon.running.surface_worker import Line

LOOPBACK = "127.0.0.1"


class LineCollector(Collector):
    """Reads the lines when it is asked, in the thread of the metrics server: plain numbers, each read at once."""

    def __init__(self, lines: Callable[[], Iterable[Line]], elsewhere: Callable[[], Mapping[str, int]]) -> None:
        self._lines = lines
        self._elsewhere = elsewhere

    def collect(self) -> Iterator[Metric]:
        """Return all metrics of all lines."""
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
            "beamtouch_rate_wrong", "1 while the measured rate is not the declared one.", labels=["surface"]
        )
        for line in list(self._lines()):
            surface, counts = [line.name], line.summary()
            readings.add_metric(surface, counts.readings)
            lost.add_metric(surface, counts.readings_lost)
            published.add_metric(surface, counts.samples_published)
            in_memory = len(line.outbox)
            dropped.add_metric(surface, max(0, counts.samples_dropped - in_memory))
            aside.add_metric(surface, counts.samples_set_aside)
            waiting.add_metric([line.name, "memory"], in_memory)
            waiting.add_metric([line.name, "disk"], counts.samples_spooled)
            age_s = line.age_s()
            if age_s is not None:
                age.add_metric(surface, age_s)
            meter = line.acquisition.meter
            if (measured_hz := meter.measured_hz) is not None:
                measured.add_metric(surface, measured_hz)
            wrong.add_metric(surface, 0 if meter.fits else 1)
        for name, samples in self._elsewhere().items():
            waiting.add_metric([name, "disk"], samples)
        yield from (readings, lost, published, dropped, aside, waiting, age, measured, wrong)


@contextmanager
def served(
    port: int | None, lines: Callable[[], Iterable[Line]], elsewhere: Callable[[], Mapping[str, int]]
) -> Iterator[None]:
    """Answer GET /metrics during the block; nothing without a port. ConfigError if the port cannot be had.

    Parameters
    ----------
    port
        On this machine.
    lines
        Gives the lines at work.
    elsewhere
        Gives the samples on disk of surfaces without a line.
    """
    if port is None:
        yield
        return
    registry = CollectorRegistry()
    registry.register(LineCollector(lines, elsewhere))
    try:
        server, thread = start_http_server(port, LOOPBACK, registry)
    except OSError as error:
        message = f"metrics.port: cannot listen on {LOOPBACK}:{port} ({error.strerror}); choose another"
        raise ConfigError(message) from error
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
