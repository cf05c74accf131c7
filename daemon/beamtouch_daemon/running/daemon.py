"""The running daemon: the log, a worker per surface, metrics and systemd, from the start to a signal."""

import asyncio
import logging
import signal
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from time import monotonic

from beamtouch_common.errors import InputError
from beamtouch_common.systemd import ServiceManager
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.delivery.backlog import Backlog
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.log_file import ForeignFileError
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.running import metrics
from beamtouch_daemon.running.surface_worker import SurfaceWorker
from beamtouch_daemon.sources.configured import Buses
from beamtouch_daemon.tasks import cancel, keep_going

WATCH_S = 1.0
"""Longest time between two checks for progress."""
FINISH_S = 2.5
"""Time limit for a stop to deliver the remaining samples; the service makes them durable once a second."""
_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Summary:
    """Final counts of one surface."""

    readings: int = 0
    """Taken."""
    readings_lost: int = 0
    """Due but not taken: poll slots, numbers of the device's sequence, and the time without a connection."""
    samples_published: int = 0
    """Durable in the record of the service."""
    samples_dropped: int = 0
    """Discarded for lack of room in memory and in the log file, lost with that file, or refused by the service."""
    samples_in_log: int = 0
    """In the log file, delivered after the next start."""


@dataclass(frozen=True)
class Ended:
    """The end of a run."""

    summaries: dict[str, Summary]
    """By surface."""
    is_interrupted: bool
    """Whether SIGINT (Ctrl-C) ended it."""


async def run(config: Config) -> Ended:
    """Read and publish all surfaces until SIGTERM, SIGINT or SIGHUP.

    Raises
    ------
    InputError
        A file that the configuration names cannot be used; nothing was read or published.
    FailedError
        Such a file cannot be read; it may come later.
    """
    secrets = config.read_token(), config.read_certificates()
    rest = {name: tare_file.load(config.tare_file(name), s.channel_names) for name, s in config.surfaces.items()}
    loop = asyncio.get_running_loop()
    signalled: asyncio.Future[signal.Signals] = loop.create_future()

    def on_signal(number: signal.Signals) -> None:
        if not signalled.done():
            signalled.set_result(number)

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        loop.add_signal_handler(number, on_signal, number)
    async with _opened_store(config) as store, ServiceClient(config.publish.url, *secrets) as client:
        buses: Buses = {}
        workers = [
            SurfaceWorker(name, surface, rest[name], config.publish, client, store, buses)
            for name, surface in config.surfaces.items()
        ]
        backlogs = [Backlog(client, name, store) for name in store.surfaces()]
        for name in store.surfaces().keys() - config.surfaces.keys():
            _log.info("%s: not configured; the samples in its log are delivered", name)
        await _serve(config, workers, backlogs, store, signalled)
        await _finish(backlogs, store)
        summaries = _summaries(workers, store)
    return Ended(summaries, signalled.result() is signal.SIGINT)


async def _serve(
    config: Config,
    workers: Sequence[SurfaceWorker],
    backlogs: Sequence[Backlog],
    store: LogStore,
    signalled: asyncio.Future[signal.Signals],
) -> None:
    """Keep everything running until a signal comes."""
    manager = ServiceManager()
    manager.ready(_status(workers))
    jobs = [(worker.name, job) for worker in workers for job in worker.jobs]
    jobs += [("backlog", backlog.run) for backlog in backlogs]
    jobs += [("log file", store.run), ("watchdog", lambda: _watch(workers, manager))]
    if (port := config.metrics.port) is not None:
        jobs.append(("metrics", lambda: metrics.serve(port, workers, store.surfaces)))
    tasks = [asyncio.create_task(keep_going(name, job)) for name, job in jobs]
    await signalled
    manager.stopping()
    await cancel(tasks)
    for worker in workers:
        worker.acquisition.process()


async def _finish(backlogs: Sequence[Backlog], store: LogStore) -> None:
    """Deliver what is left, and write the rest to the log file."""
    with suppress(TimeoutError):
        async with asyncio.timeout(FINISH_S):
            await asyncio.gather(*(backlog.finish() for backlog in backlogs))
    await store.write(None)


def _summaries(workers: Sequence[SurfaceWorker], store: LogStore) -> dict[str, Summary]:
    """Return the counts by surface. What is still in memory counts as dropped."""
    summaries = {one.name: Summary(one.acquisition.readings, one.acquisition.lost) for one in workers}
    for name, logs in store.surfaces().items():
        if lost := logs.give_up():
            _log.warning("%s: %d samples dropped: neither the service nor the log file took them", name, lost)
        summary = summaries.setdefault(name, Summary())
        summary.samples_published = logs.counts.published
        summary.samples_dropped = logs.counts.dropped
        summary.samples_in_log = logs.on_disk
    return summaries


async def _watch(workers: Sequence[SurfaceWorker], manager: ServiceManager) -> None:
    """Report progress to the service manager. While a worker hangs, nothing is reported, so the manager restarts us."""
    pause_s = min(WATCH_S, (manager.watchdog_s or WATCH_S) / 4)
    while True:
        if hanging := [worker.name for worker in workers if worker.hangs(monotonic())]:
            _log.error("no progress on %s", ", ".join(hanging))
        else:
            manager.alive(_status(workers))
        await asyncio.sleep(pause_s)


def _status(workers: Sequence[SurfaceWorker]) -> str:
    """Return which surfaces are read, and which have no device yet."""
    words = []
    for text, is_missing in (("reading", False), ("waiting for the device of", True)):
        if names := [worker.name for worker in workers if worker.acquisition.is_missing is is_missing]:
            words.append(f"{text} {', '.join(names)}")
    return "; ".join(words)


@asynccontextmanager
async def _opened_store(config: Config) -> AsyncIterator[LogStore]:
    """Open the logs for a block. InputError if their file can never be used."""
    store = LogStore(config.log_file if config.publish.log_mb else None, round(config.publish.log_mb * 1e6))
    try:
        await store.open()
        yield store
    except ForeignFileError as error:
        message = f"publish.log_file: {error}"
        raise InputError(message) from error
    finally:
        await store.close()
