"""Long work: its progress, and the form in which sweeps reach their cores, one function over many tasks.

The tasks may run in other processes. A function is one of a module, and a task holds data alone, so that both can be
sent. Random numbers are seeded by the task, and each task computes on one thread, so that its result is the same
wherever it runs.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from functools import cache
from typing import Protocol, TypeVar

from threadpoolctl import ThreadpoolController

Fraction = Callable[[float], None]
"""Called with the fraction of a piece of work that is done, 0 to 1."""
Progress = Callable[[str, float], None]
"""Called with the current step, and the fraction of the whole that is done."""


def silent(*_: object) -> None:
    """Report no progress."""


Task = TypeVar("Task")
Found = TypeVar("Found")


class TaskMap(Protocol):
    """Runs a function on all tasks, somewhere; yields what it returns in the order of the tasks."""

    def __call__(self, function: Callable[[Task], Found], tasks: Iterable[Task], /) -> Iterator[Found]:
        """Begin at once or with the first result; an error of the function is raised in the place of its result."""


def in_turn(function: Callable[[Task], Found], tasks: Iterable[Task], /) -> Iterator[Found]:
    """Run a function on one task after another, in this process, each when its result is asked for."""
    for task in tasks:
        yield on_one_thread(function, task)


def on_one_thread(function: Callable[[Task], Found], task: Task) -> Found:
    """Run a function with linear algebra on one thread: rounding depends on the number of threads."""
    with one_thread():
        return function(task)


def one_thread() -> AbstractContextManager[object]:
    """Keep linear algebra on one thread: with matrices this small, threads wait longer than they work."""
    limited: AbstractContextManager[object] = _controller().limit(limits=1)
    return limited


def load_with_one_thread() -> None:
    """Give linear algebra one thread wherever it is loaded from now on: here, and in processes that start here.

    The threads that libraries start when they are loaded wait at full load.
    """
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()
