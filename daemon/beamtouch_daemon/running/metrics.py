"""Counts and ages of all surfaces for Prometheus, on a loopback port.

The final summary needs the same counts, so workers and logs keep them, and a collector of prometheus_client reads them.
"""

import asyncio
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from beamtouch_common.listening import remedy
from beamtouch_daemon.delivery.log_store import SurfaceLogs
from beamtouch_daemon.faults import Backoff, Fault
from beamtouch_daemon.running.surface_worker import SurfaceWorker
from beamtouch_service.samples import Quality

LOOPBACK = "127.0.0.1"

_log = logging.getLogger(__name__)

Workers = Callable[[], Iterable[SurfaceWorker]]
"""Returns the workers that run now."""
Logs = Callable[[], Mapping[str, SurfaceLogs]]
"""Returns the logs of all surfaces, also of those that are no longer configured."""


class WorkerCollector(Collector):
    """Reads the workers' counts on request, in the thread of the metrics server."""

    def __init__(self, workers: Workers, logs: Logs) -> None:
        self._workers = workers
        self._logs = logs

    def collect(self) -> Iterator[Metric]:
        """Return all metrics of all surfaces."""
        readings = CounterMetricFamily("beamtouch_readings", "Readings taken.", labels=["surface"])
        lost = CounterMetricFamily("beamtouch_readings_lost", "Readings due but not taken.", labels=["surface"])
        missing = GaugeMetricFamily(
            "beamtouch_source_missing", "1 while no reading comes from the device.", labels=["surface"]
        )
        age = GaugeMetricFamily("beamtouch_reading_age_seconds", "Age of the newest reading.", labels=["surface"])
        measured = GaugeMetricFamily(
            "beamtouch_readings_per_second", "Measured rate of the readings.", labels=["surface"]
        )
        wrong = GaugeMetricFamily(
            "beamtouch_rate_wrong", "1 while the measured rate is not the configured one.", labels=["surface"]
        )
        words = "1 for the quality of a channel in the newest sample."
        labels = ["surface", "channel", "quality"]
        qualities = GaugeMetricFamily("beamtouch_channel_quality", words, labels=labels)
        for worker in list(self._workers()):
            surface = [worker.name]
            readings.add_metric(surface, worker.acquisition.readings)
            lost.add_metric(surface, worker.acquisition.lost)
            missing.add_metric(surface, worker.acquisition.is_missing)
            if (age_s := worker.age_s()) is not None:
                age.add_metric(surface, age_s)
            meter = worker.acquisition.meter
            wrong.add_metric(surface, 0 if meter.fits else 1)
            # While no reading comes, nothing is known of its rate or its channels.
            is_known = not worker.acquisition.is_missing
            if is_known and (measured_hz := meter.measured_hz) is not None:
                measured.add_metric(surface, measured_hz)
            found = worker.acquisition.quality if is_known else []
            for name, quality in zip(worker.surface.channel_names, found, strict=True) if found else ():
                for one in Quality:
                    qualities.add_metric([worker.name, name, one.value], quality is one)
        yield from (readings, lost, missing, age, measured, wrong, qualities)
        yield from self._of_logs()

    def _of_logs(self) -> Iterator[Metric]:
        words = "Samples that are durable in the record of the service."
        published = CounterMetricFamily("beamtouch_samples_published", words, labels=["surface"])
        dropped = CounterMetricFamily("beamtouch_samples_dropped", "Samples that never arrive.", labels=["surface"])
        words = "Samples that are not durable in the record yet."
        in_log = GaugeMetricFamily("beamtouch_samples_in_log", words, labels=["surface", "where"])
        words = "Starts of the daemon whose samples the service refuses."
        refused = GaugeMetricFamily("beamtouch_boots_refused", words, labels=["surface"])
        for name, logs in self._logs().items():
            published.add_metric([name], logs.counts.published)
            dropped.add_metric([name], logs.counts.dropped)
            in_log.add_metric([name, "memory"], logs.in_memory)
            in_log.add_metric([name, "disk"], logs.on_disk)
            refused.add_metric([name], logs.refused)
        yield from (published, dropped, in_log, refused)


async def serve(port: int, workers: Workers, logs: Logs) -> None:
    """Answer GET /metrics on a loopback port, as soon as it is free, until cancelled."""
    registry = CollectorRegistry()
    registry.register(WorkerCollector(workers, logs))
    fault, backoff = Fault(_log, "metrics"), Backoff()
    while True:
        try:
            server, thread = start_http_server(port, LOOPBACK, registry)
            break
        except OSError as error:
            reason = f"port {port} on {LOOPBACK}: {remedy(error, 'metrics.port')}"
            fault.failed(f"{reason}; trying again")
            await asyncio.sleep(backoff.next())
    fault.recovered()
    try:
        await asyncio.Event().wait()
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
