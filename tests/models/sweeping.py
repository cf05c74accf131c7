"""Sweeps as a user runs them: commands with worker processes, and a Dask cluster on loopback."""

import importlib.util
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from support.running.debian_parts import give_up
from support.running.waiting import wait_until

COMMAND = str(Path(sys.executable).parent / "design-sensors")
QUICKLY_TIMED = (
    sys.executable,
    "-c",
    "import sys; from beamtouch_models.lab.trade import measure; measure.CALLS, measure.ROUNDS = 5, 2; "
    "from beamtouch_models.cli import main; sys.exit(main())",
)
"""The same command, which times inferences a few times only."""
WITHIN_S = 240.0
"""Bound on anything that a starved machine is waited for."""


@contextmanager
def sweeping(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Start `design-sensors` in a process group of its own, as a terminal does; nothing of it is left at the end."""
    pipe, command = subprocess.PIPE, [COMMAND, *map(str, arguments)]
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, process_group=0) as process:
        try:
            yield process
        finally:
            if group(process.pid):
                os.killpg(process.pid, signal.SIGKILL)


def group(leader: int) -> list[int]:
    """Return the living processes of a group."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, in_group = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue  # it has ended meanwhile
        if int(in_group) == leader and state != "Z":
            found.append(int(folder.name))
    return found


def at_work(leader: int) -> list[int]:
    """Return the worker processes that have loaded what their tasks need."""
    return [pid for pid in group(leader) if pid != leader and "onnxruntime" in _maps(pid)]


def _maps(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/maps").read_text()
    except OSError:
        return ""


@contextmanager
def dask(
    folder: Path, workers: int
) -> Iterator[tuple[str, Callable[[Path], subprocess.Popen[bytes]], list[subprocess.Popen[bytes]]]]:
    """A Dask scheduler with workers of one thread, without nannies.

    Yields its address, a function that starts another worker, and the processes. What is in the folder that the
    function takes comes before what is installed.
    """
    if importlib.util.find_spec("distributed") is None:
        give_up("distributed is not installed: pip install 'beamtouch[cluster]'")
    log = folder / "dask.log"
    common = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")
    with ExitStack() as stack, log.open("wb") as output:

        def start(*arguments: str, first: Path | None = None) -> subprocess.Popen[bytes]:
            environment = {**os.environ, "PYTHONPATH": str(first)} if first else None
            command = [sys.executable, "-m", "dask", *arguments, *common]
            process = subprocess.Popen(command, cwd=folder, stdout=output, stderr=output, env=environment)
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        def start_worker(first: Path) -> subprocess.Popen[bytes]:
            before = log.read_bytes().count(b"Registered to")
            process = start("worker", address, "--nthreads", "1", "--no-nanny", first=first)
            wait_until(lambda: log.read_bytes().count(b"Registered to") > before, WITHIN_S)
            return process

        scheduler = start("scheduler", "--port", "0")
        wait_until(lambda: b"Scheduler at:" in log.read_bytes(), WITHIN_S)
        address = log.read_text().split("Scheduler at:")[1].split()[0]
        started = [start("worker", address, "--nthreads", "1", "--no-nanny") for _ in range(workers)]
        wait_until(lambda: log.read_bytes().count(b"Registered to") == workers, WITHIN_S)
        yield address, start_worker, [scheduler, *started]
