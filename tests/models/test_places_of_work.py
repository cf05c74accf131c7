"""Where the tasks of a sweep run, and when the workers of a cluster are refused or given up."""

import importlib.util
import logging
import platform
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, nullcontext
from importlib import metadata
from types import ModuleType
from typing import Any

import pytest

from beamtouch_common.errors import FailedError, InputError
from beamtouch_models.commands import workers
from beamtouch_models.commands.workers import cluster_at, processes, spread_over
from beamtouch_models.design.sweeps import in_turn


def test_one_worker_is_this_process_and_by_default_there_is_one_for_each_core(monkeypatch: pytest.MonkeyPatch) -> None:
    def place(number: int | None, cluster: str | None = None) -> object:
        where: AbstractContextManager[object] = spread_over(number, cluster)
        with where as there:
            return there

    monkeypatch.setattr(workers, "processes", lambda number: nullcontext(f"{number} processes"))
    monkeypatch.setattr(workers, "cluster_at", lambda address: nullcontext(f"cluster {address}"))
    assert (place(1), place(3)) == (in_turn, "3 processes")
    monkeypatch.setattr(workers.os, "sched_getaffinity", lambda _: {0, 1, 2, 5})  # type: ignore[attr-defined]
    assert place(None) == "4 processes"
    monkeypatch.setattr(workers.os, "sched_getaffinity", lambda _: {7})  # type: ignore[attr-defined]
    assert place(None) is in_turn
    assert place(3, "tcp://a:1") == "cluster tcp://a:1"


class KilledWorkerError(Exception):
    """Stands for that of `distributed`."""


class Client:
    """Stands for the client of a cluster whose workers have other versions, come, and go."""

    theirs: dict[str, object]
    """What the second worker has, by what it is asked for."""
    there: list[bool]
    """Whether there are workers, at each look; the last one counts ever after."""
    closed: list[float]

    def __init__(self, address: str, *, timeout: float, set_as_default: bool) -> None:
        assert (address, timeout > 1, set_as_default) == ("tcp://a:1", True, False)

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        assert n_workers == -1
        has_some = self.there.pop(0) if len(self.there) > 1 else self.there[0]
        return {"workers": {"w1": {}}} if has_some else {}

    def run(self, ask: Callable[[], str], *, on_error: str) -> dict[str, object]:
        assert on_error == "return"
        name = getattr(ask, "args", ("Python",))[0]
        return {"w1": ask(), "w2": self.theirs.get(name, ask())}

    def get_executor(self, *, pure: bool) -> Executor:
        assert not pure
        return ThreadPoolExecutor(1)

    def close(self, timeout: float) -> None:
        self.closed.append(timeout)


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Client]]:
    main, versions = ModuleType("distributed"), ModuleType("distributed.versions")
    main.__dict__.update(Client=Client, KilledWorker=KilledWorkerError)
    versions.__dict__.update(VersionMismatchWarning=UserWarning)
    monkeypatch.setitem(sys.modules, "distributed", main)
    monkeypatch.setitem(sys.modules, "distributed.versions", versions)
    monkeypatch.setattr(workers, "LOOKED_S", 0.01)
    Client.theirs, Client.there, Client.closed = {}, [True], []
    yield Client
    logging.disable(logging.NOTSET)


def test_results_come_in_the_order_of_their_tasks(client: type[Client]) -> None:
    with cluster_at("tcp://a:1") as spread:
        assert logging.root.manager.disable == logging.CRITICAL  # what `distributed` says of errors is said here
        assert list(spread(str, range(12))) == [str(number) for number in range(12)]
        assert client.closed == []
    assert len(client.closed) == 1


@pytest.mark.parametrize("error", [OSError, ValueError, TypeError, RuntimeError])
def test_an_address_where_no_scheduler_answers_is_named(client: type[Client], error: type[Exception]) -> None:
    assert client

    def refuse(*_: object, **__: object) -> None:
        raise error

    sys.modules["distributed"].__dict__["Client"] = refuse
    with pytest.raises(InputError, match=r"^--cluster tcp://a:1: no Dask scheduler answers there; start `dask sch"):
        cluster_at("tcp://a:1").__enter__()


class Pool(ThreadPoolExecutor):
    """Stands for the processes; notes whether Ctrl-C is blocked at each task, and how often it was shut down."""

    def __init__(self, *given: object, **how: object) -> None:
        super().__init__(1)
        self.given, self.how, self.shut = given, how, 0
        self.blocked = list[bool]()

    def submit(self, *given: Any, **how: Any) -> Any:  # noqa: ANN401
        self.blocked.append(is_blocked())
        return super().submit(*given, **how)

    def shutdown(self, *given: Any, **how: Any) -> None:  # noqa: ANN401
        self.shut += 1
        super().shutdown(*given, **how)


def is_blocked() -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, set())


@pytest.fixture
def pools(monkeypatch: pytest.MonkeyPatch) -> list[Pool]:
    pools = list[Pool]()

    def make(*given: object, **how: object) -> Pool:
        pools.append(Pool(*given, **how))
        return pools[-1]

    monkeypatch.setattr(workers, "ProcessPoolExecutor", make)
    return pools


def test_processes_start_with_ctrl_c_blocked_and_this_one_hears_it_again(pools: list[Pool]) -> None:
    with processes(3) as spread:
        assert list(spread(str, range(4))) == ["0", "1", "2", "3"]
        assert not is_blocked()
    (pool,) = pools
    assert pool.given == (3,)
    assert pool.how["mp_context"].get_start_method() == "spawn"  # type: ignore[attr-defined]
    assert pool.blocked == [True] * 4
    assert pool.shut >= 1


def test_a_process_that_ends_early_is_told_and_the_others_are_ended(pools: list[Pool]) -> None:
    def die(_: object) -> None:
        raise BrokenProcessPool

    with (
        pytest.raises(FailedError, match=r"^a worker process ended before its work was done; if memory was short, use"),
        processes(2) as spread,
    ):
        list(spread(die, [1]))
    assert pools[0].shut == 1
    with pytest.raises(KeyError), processes(2) as spread:
        list(spread(dict[str, int]().__getitem__, ["none"]))
    assert pools[1].shut == 1


def test_what_only_a_cluster_needs_is_not_imported_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    spec = importlib.util.spec_from_file_location("again", workers.__file__)
    assert spec is not None
    assert spec.loader is not None
    spec.loader.exec_module(importlib.util.module_from_spec(spec))


PYTHON, NUMPY = platform.python_version(), metadata.version("numpy")


@pytest.mark.parametrize(
    ("asked", "theirs", "said"),
    [
        ("numpy", "0.1", f"has numpy 0.1; install 'beamtouch[design,cluster]' there, with numpy {NUMPY}"),
        ("scipy", ModuleNotFoundError("scipy"), "has no scipy; install 'beamtouch[design,cluster]' there, with scipy "),
        ("Python", "2.7.3", f"has Python 2.7.3; install 'beamtouch[design,cluster]' there, with Python {PYTHON}"),
        ("numpy", f"{NUMPY}.1", f"has numpy {NUMPY}.1; "),
    ],
)
def test_a_worker_with_another_version_is_refused_by_name(
    client: type[Client], asked: str, theirs: object, said: str
) -> None:
    client.theirs = {asked: theirs}
    with pytest.raises(InputError) as refused, cluster_at("tcp://a:1"):
        pass
    assert str(refused.value).startswith(f"--cluster tcp://a:1: its worker w2 {said}")
    assert len(client.closed) == 1


def test_a_python_that_differs_in_its_last_number_only_is_taken(client: type[Client]) -> None:
    client.theirs = {"Python": f"{PYTHON.rpartition('.')[0]}.99"}
    with cluster_at("tcp://a:1") as spread:
        assert list(spread(abs, [-1])) == [1]


def test_a_cluster_without_workers_is_refused(client: type[Client]) -> None:
    client.there = [False]
    with pytest.raises(InputError, match=r"it has no workers; run `dask worker tcp://a:1 --nthreads 1` on each"):
        cluster_at("tcp://a:1").__enter__()


@pytest.mark.parametrize("there", [[True, False], [True, True, True, False]])
def test_work_ends_once_there_have_been_no_workers_for_too_long(client: type[Client], there: list[bool]) -> None:
    client.there, over = there, threading.Event()
    try:
        with (
            pytest.raises(FailedError, match="its scheduler or its workers ended before the work was done"),
            cluster_at("tcp://a:1", without_workers_s=0.0) as spread,
        ):
            list(spread(over.wait, [60.0]))
    finally:
        over.set()
    assert client.there == [False]


def test_work_goes_on_while_workers_are_away_for_a_shorter_time(client: type[Client]) -> None:
    client.there, over = [True, False, False, True], threading.Event()

    def work(_: object) -> str:
        over.wait(60.0)
        return "done"

    def look(_: Client, n_workers: int) -> dict[str, Any]:
        if len(client.there) == 1:
            over.set()
        return Client.scheduler_info(_, n_workers)

    with pytest.MonkeyPatch.context() as patch:
        looking = type("Looking", (Client,), {"scheduler_info": look})
        patch.setattr(sys.modules["distributed"], "Client", looking)
        with cluster_at("tcp://a:1", without_workers_s=60.0) as spread:
            assert list(spread(work, [1])) == ["done"]


def test_a_task_that_runs_into_a_timeout_of_its_own_ends_with_it(client: type[Client]) -> None:
    assert client

    def fail(_: object) -> None:
        raise TimeoutError("of the task")

    with pytest.raises(TimeoutError, match="of the task"), cluster_at("tcp://a:1") as spread:
        list(spread(fail, [1]))


def test_a_killed_worker_ends_the_work(client: type[Client]) -> None:
    assert client

    def fail(_: object) -> None:
        raise KilledWorkerError

    with pytest.raises(FailedError, match="ended before the work was done"), cluster_at("tcp://a:1") as spread:
        list(spread(fail, [1]))
