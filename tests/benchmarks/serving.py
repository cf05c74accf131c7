"""The service as a process of its own, and programs that ask it or send to it, for benchmarks."""

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from support.programs.processes import processor_s

TOKEN = "a-token-of-this-benchmark"  # noqa: S105
HERE = Path(__file__).parent


@contextmanager
def server(*command: str | Path, checkout: Path | None = None) -> Iterator[tuple[int, int]]:
    """Run a server in Python for a block, with the packages of another checkout or with these.

    Gives its process id and its port.
    """
    words = [sys.executable, *map(str, command)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=_environment(checkout))
    try:
        assert process.stdout is not None
        yield process.pid, int(process.stdout.readline().rpartition(":")[2])
    finally:
        process.terminate()
        process.wait(timeout=30)


def build_with(checkout: Path | None, folder: Path) -> None:
    """Build the scene `bench` into a folder with the packages of another checkout, or with these."""
    tests = (checkout or HERE.parent.parent) / "tests"
    code = "import sys; from pathlib import Path; from shipped import build; build(Path(sys.argv[1]))"
    environment = _environment(checkout, tests, tests / "benchmarks")
    subprocess.run([sys.executable, "-c", code, str(folder)], env=environment, check=True)


def _environment(checkout: Path | None, *more: Path) -> dict[str, str]:
    packages = ("common", "firmware_protocol", "models", "service") if checkout else ()
    places = [*((checkout or HERE) / name for name in packages), *more]
    return dict(os.environ) | ({"PYTHONPATH": os.pathsep.join(map(str, places))} if places else {})


@contextmanager
def service(folder: Path, sections: str, checkout: Path | None = None) -> Iterator[tuple[int, int]]:
    """Run a service with these sections of a configuration for a block, as `server` does."""
    (folder / "token").write_text(TOKEN)
    (folder / "service.toml").write_text(f'[server]\nport = 0\nwrite_token_file = "token"\n{sections}')
    command = ("-m", "beamtouch_service.cli", "run", "--config", folder / "service.toml")
    with server(*command, checkout=checkout) as running:
        yield running


def surfaces(names: Iterable[str]) -> str:
    """Return the sections of surfaces with the model of the scene `bench`, which is beside the configuration."""
    return "".join(f'[surfaces.{name}]\nmodel = "bench.onnx"\n' for name in names)


def loaded(pid: int, script: str, *arguments: object) -> tuple[dict[str, Any], float]:
    """Run a script of this folder that loads a server; return what it prints, and the server's processor time [s]."""
    begin_s = processor_s(pid)
    words = [sys.executable, str(HERE / script), *map(str, arguments)]
    found: dict[str, Any] = json.loads(subprocess.check_output(words, text=True))
    return found, processor_s(pid) - begin_s
