"""Where the tasks of a sweep run, and when the workers of a cluster are refused or given up."""

import logging
import platform
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from importlib import metadata
from types import ModuleType
from typing import Any

import pytest

from beamtouch_common.errors import FailedError, InputError
from beamtouch_models.commands import workers
from beamtouch_models.commands.workers import cluster_at, spread_over
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
        assert list(spread(str, range(12))) == [str(number) for number in range(12)]
        assert client.closed == []
    assert len(client.closed) == 1


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
