"""The running daemon: signals, the logs, the metrics, and the supervisor of all surfaces."""

import asyncio
import logging
import signal
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from time import monotonic

from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.systemd import ServiceManager
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.delivery.log_file import ForeignFileError
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.running import metrics
from beamtouch_daemon.running.supervisor import Summary, Supervisor
from beamtouch_daemon.tasks import cancel, keep_going

WATCH_S = 1.0
"""Longest time between two checks for progress."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Ended:
    """The end of a run."""

    summaries: dict[str, Summary]
    """By surface."""
    is_interrupted: bool
    """Whether SIGINT (Ctrl-C) ended it."""


async def run(load: Callable[[], Config]) -> Ended:
    """Read and publish all surfaces of a configuration until SIGTERM or SIGINT; SIGHUP loads it again.

    Raises
    ------
    InputError
        The configuration, or a file that it names, cannot be used; nothing was read or published.
    FailedError
        A file that it names cannot be read; it may come later.
    """
    config = load()
    stop, reload = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()
    signals: list[signal.Signals] = []

    def on_signal(number: signal.Signals) -> None:
        signals.append(number)
        stop.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, on_signal, number)
    loop.add_signal_handler(signal.SIGHUP, reload.set)
    failure: InputError | FailedError | None = None
    async with _store(config) as store, asyncio.TaskGroup() as group:
        supervisor = Supervisor(group, store)
        try:
            await supervisor.apply(config)
            summaries = await _serve(load, config, supervisor, group, (stop, reload), store)
            return Ended(summaries, signals[0] is signal.SIGINT)
        except (InputError, FailedError) as error:
            failure = error  # raised here, it would be wrapped in an exception group
    raise failure


async def _serve(
    load: Callable[[], Config],
    config: Config,
    supervisor: Supervisor,
    group: asyncio.TaskGroup,
    events: tuple[asyncio.Event, asyncio.Event],
    store: LogStore,
) -> dict[str, Summary]:
    """Keep the workers running until the stop event."""
    stop, reload = events
    manager = ServiceManager()
    manager.ready(_status(supervisor))
    helpers = {
        group.create_task(_watch(supervisor, manager)),
        group.create_task(keep_going("log file", store.run)),
        group.create_task(_reload_on_event(load, config, supervisor, manager, reload)),
    }
    if config.metrics.port is not None:
        answer = metrics.serve(config.metrics.port, lambda: supervisor.workers, store.surfaces)
        helpers.add(group.create_task(answer))
    await stop.wait()
    manager.stopping()
    await cancel(helpers)
    return await supervisor.stop()


async def _watch(supervisor: Supervisor, manager: ServiceManager) -> None:
    """Report progress to the service manager. While a worker hangs, nothing is reported, so the manager restarts us."""
    pause_s = min(WATCH_S, (manager.watchdog_s or WATCH_S) / 4)
    while True:
        hanging = [worker.name for worker in supervisor.workers if worker.hangs(monotonic())]
        if hanging:
            _log.error("no progress on %s", ", ".join(hanging))
        else:
            manager.alive(_status(supervisor))
        await asyncio.sleep(pause_s)


async def _reload_on_event(
    load: Callable[[], Config],
    config: Config,
    supervisor: Supervisor,
    manager: ServiceManager,
    reload: asyncio.Event,
) -> None:
    """Read the configuration again after each `reload` event; a wrong configuration changes nothing."""
    while True:
        await reload.wait()
        reload.clear()
        manager.reloading()
        try:
            new = load()
            changed = _needing_restart(config, new)
            started = await supervisor.apply(new)
        except (InputError, FailedError) as error:
            _log.error("the new configuration is wrong, the old one stays in use: %s", error)
        else:
            _log.info("configuration read again; restarted: %s", ", ".join(started) or "nothing")
            if changed:
                _log.warning("changes that need a restart of the daemon: %s", ", ".join(changed))
            config = new
        manager.ready(_status(supervisor))


def _needing_restart(old: Config, new: Config) -> list[str]:
    """Return the keys that have changed and are only read at the start."""
    changed = {
        "publish.log_file": old.log_file != new.log_file,
        "publish.log_mb": old.publish.log_mb != new.publish.log_mb,
        "metrics.port": old.metrics != new.metrics,
    }
    return [name for name, differs in changed.items() if differs]


def _status(supervisor: Supervisor) -> str:
    """Return which surfaces are read, and which have no device yet."""
    names: dict[bool, list[str]] = {False: [], True: []}
    for worker in supervisor.workers:
        names[worker.acquisition.is_missing].append(worker.name)
    words = {"reading": names[False], "waiting for the device of": names[True]}
    return "; ".join(f"{word} {', '.join(found)}" for word, found in words.items() if found)


@asynccontextmanager
async def _store(config: Config) -> AsyncIterator[LogStore]:
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
