"""The running daemon, from its start to a signal: acquisitions, the log with its readers, metrics and systemd."""

import asyncio
import logging
import signal
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from time import monotonic

from beamtouch_common.errors import InputError
from beamtouch_common.parts import Parts
from beamtouch_common.systemd import ServiceManager
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.config.tare_file import NOT_TARED, TareFile
from beamtouch_daemon.delivery.backlog import Backlog
from beamtouch_daemon.delivery.boots import SurfaceLogs
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.live import Live
from beamtouch_daemon.delivery.log_file import ForeignFileError
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.filters import rest_of
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.running import metrics
from beamtouch_daemon.running.acquisition import Acquisition
from beamtouch_daemon.running.kept_zeros import KeptZeros, SurfaceZeros
from beamtouch_daemon.sources.configured import Buses, source_of
from beamtouch_daemon.tasks import cancel
from beamtouch_models.filters import TARED, Rested
from beamtouch_service.samples import Batch

WATCH_S = 1.0
"""Longest time between two checks for progress."""
FINISH_S = 2.5
"""Time limit for a stop to deliver the remaining samples; the service makes them durable once a second."""
RECENT_S = 60.0
"""Age of a tare up to which a start says nothing of it: zeros have hardly drifted."""
_logger = logging.getLogger(__name__)


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


async def run(config: Config) -> tuple[dict[str, Summary], bool]:
    """Read and publish all surfaces until SIGTERM, SIGINT or SIGHUP.

    Returns the counts by surface, and whether SIGINT (Ctrl-C) ended it.

    Raises
    ------
    InputError
        A file that the configuration names cannot be used; nothing was read or published.
    FailedError
        Such a file cannot be read; it may come later.
    """
    tares = config.read_tares()
    loop = asyncio.get_running_loop()
    signalled: asyncio.Future[signal.Signals] = loop.create_future()

    def on_signal(number: signal.Signals) -> None:
        if not signalled.done():
            signalled.set_result(number)

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        loop.add_signal_handler(number, on_signal, number)
    async with ServiceClient.of(config) as client, _opened_store(config) as store:
        buses: Buses = {}
        zeros = KeptZeros(config.zeros_file if config.publish.log_mb else None)
        acquisitions = [_begin(config, name, tare, zeros, store, buses) for name, tare in tares.items()]
        parts = Parts(_logger)
        jobs = dict[str, Callable[[], Awaitable[None]]]()
        for acquisition in acquisitions:
            name = acquisition.name
            jobs[f"{name} readings"], jobs[f"{name} samples"] = acquisition.read, acquisition.run
            jobs[f"{name} live"] = Live(client, store.surface(name), acquisition.boot).run
        jobs |= {"backlogs": lambda: _deliver_backlogs(config, client, store, parts), "log file": store.run}
        jobs["zeros"] = lambda: zeros.keep(lambda: _zeros_of(acquisitions))
        if (port := config.metrics.port) is not None:
            jobs["metrics"] = lambda: metrics.serve(port, acquisitions, store.surfaces, parts)
        await _serve(acquisitions, jobs, parts, signalled)
        for acquisition in acquisitions:
            with _reported(f"{acquisition.name} samples"):
                acquisition.process()
        with _reported("zeros"):
            zeros.write(_zeros_of(acquisitions))
        await _finish(client, store)
        summaries = _summaries(acquisitions, store)
    return summaries, signalled.result() is signal.SIGINT


def _begin(
    config: Config, name: str, tare: TareFile | None, zeros: KeptZeros, store: LogStore, buses: Buses
) -> Acquisition:
    """Return the acquisition of a surface, with a new log; without a tare, the log says so."""
    surface, publish = config.surfaces[name], config.publish
    rest_gap_mm = {} if tare is None else tare.rest_gap_mm
    characteristic = Characteristic.of(surface, rest_gap_mm).identity
    if tare is None:
        _logger.warning("%s: %s", name, NOT_TARED)
    rested = zeros.rested(name, characteristic) or _tared(name, surface, tare)
    head = Batch.model_construct(
        boot_id=str(uuid.uuid4()),
        channels=surface.channel_names,
        samples=[],
        noise_mm=None if surface.noise_mm is None else [surface.noise_mm] * len(surface.channels),
        characteristic=characteristic,
        tared_at=None if tare is None else tare.stated_time,
        beam=surface.beam,
    )
    boot = store.surface(name).begin(head, publish.log_samples)
    rest = rest_of(surface) if publish.rest_ms else None
    source, pipeline = source_of(surface, name, buses), Pipeline(surface, rest_gap_mm, rest, rested)
    times_s = publish.batch_ms / 1e3, publish.rest_ms / 1e3
    return Acquisition(name, surface, source, pipeline, boot, *times_s, is_tared=tare is not None)


def _tared(name: str, surface: Surface, tare: TareFile | None) -> Rested:
    """Return the last tare as the last rest, and say what that means for a load that lies on the beam."""
    if tare is None:
        return TARED
    age_s = tare.age_s(datetime.now(UTC))
    if surface.zero_tracking is not None and age_s > RECENT_S:
        words = (
            "%s: of its zeros, only those of the tare are known (%s): a light load that lies on the beam now is taken "
            "for their drift"
        )
        _logger.info(words, name, tare.taken_at)
    return Rested(age_s)


def _zeros_of(acquisitions: Sequence[Acquisition]) -> dict[str, SurfaceZeros]:
    """Return what is known of zeros, by surface."""
    return {acquisition.name: zeros for acquisition in acquisitions if (zeros := acquisition.zeros) is not None}


async def _serve(
    acquisitions: Sequence[Acquisition],
    jobs: Mapping[str, Callable[[], Awaitable[None]]],
    parts: Parts,
    signalled: asyncio.Future[signal.Signals],
) -> None:
    """Keep all jobs running until a signal comes."""
    manager = ServiceManager()
    manager.ready(_status(acquisitions, parts))
    work = {**jobs, "watchdog": lambda: _watch(acquisitions, parts, manager)}
    tasks = [asyncio.create_task(parts.keep(name, job)) for name, job in work.items()]
    await signalled
    manager.stopping()
    await cancel(tasks)


@contextmanager
def _reported(name: str) -> Iterator[None]:
    """Let an unexpected error in a last piece of work keep no other one from being done."""
    try:
        yield
    except Exception:
        _logger.critical("%s: unexpected error while stopping", name, exc_info=True)


async def _deliver_backlogs(config: Config, client: ServiceClient, store: LogStore, parts: Parts) -> None:
    """Deliver the backlog of each surface, also of those that a log file shows which is opened late."""
    begun: set[str] = set()
    line = asyncio.Lock()
    async with asyncio.TaskGroup() as backlogs:
        while True:
            for name, logs in store.surfaces().items():
                if name not in begun:
                    begun.add(name)
                    backlogs.create_task(parts.keep(f"{name} backlog", Backlog(client, store, logs, line).run))
                    if name not in config.surfaces:
                        _logger.info("%s: not configured; the samples in its log are delivered", name)
            await asyncio.sleep(WATCH_S)


async def _finish(client: ServiceClient, store: LogStore) -> None:
    """Deliver what is left, and write the rest to the log file."""
    line = asyncio.Lock()

    async def deliver(name: str, logs: SurfaceLogs) -> None:
        with _reported(f"{name} backlog"):
            await Backlog(client, store, logs, line).finish()

    with suppress(TimeoutError):
        async with asyncio.timeout(FINISH_S):
            await asyncio.gather(*(deliver(name, logs) for name, logs in store.surfaces().items()))
    with _reported("log file"):
        await store.write(None)


def _summaries(acquisitions: Sequence[Acquisition], store: LogStore) -> dict[str, Summary]:
    """Return the counts by surface. What is still in memory counts as dropped."""
    summaries = {acquisition.name: Summary(acquisition.readings, acquisition.lost) for acquisition in acquisitions}
    for name, logs in store.surfaces().items():
        if lost := logs.give_up():
            _logger.warning("%s: %d samples dropped: neither the service nor the log file took them", name, lost)
        summary = summaries.setdefault(name, Summary())
        summary.samples_published = logs.counts.published
        summary.samples_dropped = logs.counts.dropped
        summary.samples_in_log = logs.on_disk
    return summaries


async def _watch(acquisitions: Sequence[Acquisition], parts: Parts, manager: ServiceManager) -> None:
    """Report progress to the service manager. While a surface hangs, nothing is reported: the manager restarts us."""
    pause_s = min(WATCH_S, (manager.watchdog_s or WATCH_S) / 4)
    while True:
        if hanging := _hanging(acquisitions, parts):
            _logger.error("no progress on %s", ", ".join(hanging))
        else:
            manager.alive(_status(acquisitions, parts))
        await asyncio.sleep(pause_s)


def _hanging(acquisitions: Sequence[Acquisition], parts: Parts) -> list[str]:
    """Return the surfaces that hang. One whose reading fails and is restarted does not: a restart of all helps none."""
    now_s, failing = monotonic(), parts.failing
    return [
        acquisition.name
        for acquisition in acquisitions
        if acquisition.hangs(now_s) and not failing.get(f"{acquisition.name} readings")
    ]


def _status(acquisitions: Sequence[Acquisition], parts: Parts) -> str:
    """Return which surfaces are read, which have no device yet, which are not tared, and what fails."""
    groups = {
        "reading": [acquisition.name for acquisition in acquisitions if not acquisition.is_missing],
        "waiting for the device of": [acquisition.name for acquisition in acquisitions if acquisition.is_missing],
        "not tared:": [acquisition.name for acquisition in acquisitions if not acquisition.is_tared],
        "unexpected error in": [name for name, why in parts.failing.items() if why],
    }
    return "; ".join(f"{words} {', '.join(names)}" for words, names in groups.items() if names)


@asynccontextmanager
async def _opened_store(config: Config) -> AsyncIterator[LogStore]:
    """Open the logs for a block. InputError if their file can never be used."""
    store = LogStore(config.log_file if config.publish.log_mb else None, round(config.publish.log_mb * 1e6))
    try:
        await store.open()
        yield store
    except ForeignFileError as error:
        raise InputError(f"publish.log_file: {error}") from error
    finally:
        await store.close()
