"""Counts and ages of all surfaces for Prometheus, on a loopback port.

The final summary needs the same counts, so acquisitions and logs keep them; a collector of prometheus_client reads
them.
"""

import asyncio
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from threading import Thread
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from beamtouch_common.listening import remedy
from beamtouch_common.log_lines import Repeated
from beamtouch_common.parts import Parts
from beamtouch_common.uptime import uptime_s
from beamtouch_common.waits import Backoff
from beamtouch_daemon.delivery.boots import SurfaceLogs
from beamtouch_daemon.running.acquisition import Acquisition
from beamtouch_service.samples import Quality

LOOPBACK = "127.0.0.1"
WATCH_S = 1.0
"""Time between two looks at the thread that answers."""
_logger = logging.getLogger(__name__)

Logs = Callable[[], Mapping[str, SurfaceLogs]]
"""Returns the logs of all surfaces, also of those that are not configured."""


class CountCollector(Collector):
    """Reads the counts of acquisitions and logs on request, in the thread of the metrics server."""

    def __init__(self, acquisitions: Sequence[Acquisition], logs: Logs, parts: Parts) -> None:
        self._acquisitions = acquisitions
        self._logs = logs
        self._parts = parts

    def collect(self) -> Iterator[Metric]:
        """Return all metrics of all surfaces."""
        readings = _counter("readings", "Readings taken.")
        lost = _counter("readings_lost", "Readings due but not taken.")
        missing = _gauge("source_missing", "1 while no reading comes from the device.")
        age = _gauge("reading_age_seconds", "Age of the newest reading.")
        measured = _gauge("readings_per_second", "Measured rate of the readings.")
        wrong = _gauge("rate_wrong", "1 while the measured rate is not the configured one.")
        untared = _gauge("untared", "1 while the rest gaps are those of the configuration, as no tare has been taken.")
        requests = _counter("requests", "Requests to a unit.", "unit")
        requests_failed = _counter("requests_failed", "Requests without an answer that can be used.", "unit", "reason")
        qualities = _gauge(
            "channel_quality", "1 for the quality of a channel in the newest sample.", "channel", "quality"
        )
        for acquisition in self._acquisitions:
            name = acquisition.name
            readings.add_metric([name], acquisition.readings)
            lost.add_metric([name], acquisition.lost)
            missing.add_metric([name], acquisition.is_missing)
            untared.add_metric([name], not acquisition.is_tared)
            wrong.add_metric([name], not acquisition.meter.fits)
            for unit, counts in acquisition.source.requests.items():
                requests.add_metric([name, unit], counts.asked)
                for reason, number in list(counts.failed.items()):  # which the event loop may change meanwhile
                    requests_failed.add_metric([name, unit, reason], number)
            if acquisition.last_s is not None:
                age.add_metric([name], uptime_s() - acquisition.last_s)
            if acquisition.is_missing:
                continue  # nothing is known of its rate or its channels
            if (measured_hz := acquisition.meter.measured_hz) is not None:
                measured.add_metric([name], measured_hz)
            for channel, quality in zip(acquisition.surface.channel_names, acquisition.quality, strict=False):
                for word in Quality:
                    qualities.add_metric([name, channel, word.value], quality is word)
        yield from (readings, lost, missing, age, measured, wrong, untared, requests, requests_failed, qualities)
        yield from self._of_logs()
        yield from self._of_parts()

    def _of_logs(self) -> Iterator[Metric]:
        published = _counter("samples_published", "Samples that are durable in the record of the service.")
        dropped = _counter("samples_dropped", "Samples that never arrive.")
        in_log = _gauge("samples_in_log", "Samples that are not durable in the record yet.", "where")
        refused = _gauge("boots_refused", "Starts of the daemon whose samples the service refuses.")
        thin = _gauge("line_thin", "1 while requests to the service take so long that they are made small.")
        for name, logs in self._logs().items():
            thin.add_metric([name], logs.is_line_thin)
            published.add_metric([name], logs.counts.published)
            dropped.add_metric([name], logs.counts.dropped)
            in_log.add_metric([name, "memory"], logs.in_memory)
            in_log.add_metric([name, "disk"], logs.on_disk)
            refused.add_metric([name], logs.refused)
        yield from (published, dropped, in_log, refused, thin)

    def _of_parts(self) -> Iterator[Metric]:
        words = "1 while a part of the daemon fails and is begun again."
        failing = GaugeMetricFamily("beamtouch_part_failing", words, labels=["part"])
        words = "Times that a part of the daemon failed and was begun again."
        failures = CounterMetricFamily("beamtouch_part_failures", words, labels=["part"])
        for name, count in list(self._parts.failures.items()):
            failing.add_metric([name], bool(self._parts.failing.get(name)))
            failures.add_metric([name], count)
        yield from (failing, failures)


def _counter(name: str, meaning: str, *labels: str) -> CounterMetricFamily:
    return CounterMetricFamily(f"beamtouch_{name}", meaning, labels=["surface", *labels])


def _gauge(name: str, meaning: str, *labels: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"beamtouch_{name}", meaning, labels=["surface", *labels])


async def serve(port: int, acquisitions: Sequence[Acquisition], logs: Logs, parts: Parts) -> None:
    """Answer GET /metrics on a loopback port, as soon as it is free, until cancelled."""
    registry = CollectorRegistry()
    registry.register(CountCollector(acquisitions, logs, parts))
    fault, backoff = Repeated(_logger, "metrics"), Backoff()
    while True:
        try:
            server, thread = start_http_server(port, LOOPBACK, registry)
            break
        except OSError as error:
            reason = f"port {port} on {LOOPBACK}: {remedy(error, 'metrics.port')}"
            fault.failed(f"{reason}; trying again")
            await asyncio.sleep(backoff.next())
    fault.over()
    try:
        while thread.is_alive():  # noqa: ASYNC110  # a thread cannot be awaited
            await asyncio.sleep(WATCH_S)
        raise RuntimeError("the thread that answers has ended")
    finally:
        # In a thread: it takes half a second, in which the last samples are to be delivered.
        Thread(target=_end, args=(server,), daemon=True).start()


def _end(server: WSGIServer) -> None:
    server.shutdown()
    server.server_close()
