"""The whole line as real processes: rigs, one service, one daemon. Used by the demo and the system tests."""

import bisect
import os
import secrets
import selectors
import subprocess
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import tomli_w

Kind = Literal["modbus-tcp", "modbus-rtu", "serial"]
START_TIMEOUT_S = 120.0
STOP_TIMEOUT_S = 60.0
"""Generous: a machine may be busy with much else."""
TRUTH_GAP_S = 0.05
"""Gap between two rows of the truth from which it counts as interrupted; the rig writes a row every 10 ms."""


@dataclass(frozen=True)
class Surface:
    """One surface of the line: its rig, and the kind of source by which the daemon reads it."""

    name: str
    kind: Kind
    script: Path | None = None
    rig_options: tuple[str, ...] = ()


class Line:
    """Rigs, service and daemon for surfaces of one model; a context manager that ends all of them.

    Parameters
    ----------
    folder : folder for config, token, truth and log files
    scene, model : scene file and the model file built from it
    daemon_config : the config that `design-sensors build --daemon-config` wrote for the model
    surfaces : the surfaces to run
    sections : further sections of the configuration of the service
    """

    def __init__(
        self,
        folder: Path,
        scene: Path,
        model: Path,
        daemon_config: Path,
        surfaces: Sequence[Surface],
        sections: Mapping[str, Any] | None = None,
    ) -> None:
        self.folder, self.surfaces, self._sections = folder, surfaces, dict(sections or {})
        self.url = ""
        """Base URL of the service, once started."""
        self.summary = folder / "summary.json"
        """File to which the daemon writes its counts when it ends."""
        self._scene, self._model, self._generated = scene, model, daemon_config
        self._processes: dict[str, subprocess.Popen[str]] = {}

    def truth(self, surface: str) -> Path:
        """Return the CSV file to which the rig of a surface writes the true loads."""
        return self.folder / f"{surface}.csv"

    def __enter__(self) -> Self:
        try:
            (self.folder / "token").write_text(secrets.token_urlsafe(32))
            sources = {surface.name: self._start_rig(surface) for surface in self.surfaces}
            self.url = self._start_service()
            self._start_daemon(sources)
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()

    def stop(self) -> None:
        """End all running processes, the daemon first, so that it can deliver its samples."""
        for name in reversed(list(self._processes)):
            self.end(name)

    def end(self, name: str) -> int:
        """End one process, "daemon", "service" or "rig-NAME", by SIGTERM; returns its exit code."""
        process = self._processes.pop(name)
        process.terminate()
        try:
            return process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise
        finally:
            if process.stdout is not None:
                process.stdout.close()

    def kill_service(self) -> None:
        """Kill the service, and start it anew at the same address."""
        process = self._processes.pop("service")
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()
        self._start_service(int(self.url.rpartition(":")[2]))

    def restart_daemon(self) -> None:
        """End the daemon, and start it with the configuration that `daemon.toml` now holds."""
        self.end("daemon")
        self._run_daemon()

    def dead(self) -> list[str]:
        """Return the names of the processes that have ended by themselves."""
        return [name for name, process in self._processes.items() if process.poll() is not None]

    def pids(self) -> dict[str, int]:
        """Return the process ids by name."""
        return {name: process.pid for name, process in self._processes.items()}

    def log(self, name: str) -> str:
        """Return what a process wrote to stderr."""
        return (self.folder / f"{name}.log").read_text()

    def _start_rig(self, surface: Surface) -> dict[str, Any]:
        """Start the rig of a surface; returns the `source` table of the daemon's config."""
        path = self.folder / f"{surface.name}.line"
        where = "127.0.0.1:0" if surface.kind == "modbus-tcp" else str(path)
        options = ["--script", str(surface.script)] if surface.script else []
        command = ["beamtouch-rig", str(self._scene), "--model", str(self._model), f"--{surface.kind}", where]
        self._start(
            f"rig-{surface.name}", [*command, "--truth", str(self.truth(surface.name)), *options, *surface.rig_options]
        )
        said = self._first_line(f"rig-{surface.name}")
        if surface.kind == "modbus-tcp":
            return {"kind": surface.kind, "host": "127.0.0.1", "port": int(said.rpartition(":")[2])}
        return {"kind": surface.kind, "port": str(path), "baud": 115_200 if surface.kind == "modbus-rtu" else 1_000_000}

    def _start_service(self, port: int = 0) -> str:
        surfaces = {surface.name: {"model": str(self._model)} for surface in self.surfaces}
        server = {"port": port, "write_token_file": "token"}
        config = {"server": server, "events": {"file": "events.db"}, "surfaces": surfaces, **self._sections}
        (self.folder / "service.toml").write_text(tomli_w.dumps(config))
        self._start("service", ["beamtouch-service", "run", "--config", str(self.folder / "service.toml")])
        return self._first_line("service").rpartition(" ")[2]

    def _start_daemon(self, sources: dict[str, dict[str, Any]]) -> None:
        config = tomllib.loads(self._generated.read_text())
        (template,) = config["surfaces"].values()
        config["publish"].update({"url": self.url, "token_file": "token"})
        config["surfaces"] = {name: {**template, "source": source} for name, source in sources.items()}
        (self.folder / "daemon.toml").write_text(tomli_w.dumps(config))
        self._run_daemon()

    def _run_daemon(self) -> None:
        config = self.folder / "daemon.toml"
        self._start("daemon", ["beamtouch-daemon", "run", str(config), "--summary", str(self.summary)])

    def _start(self, name: str, command: list[str]) -> None:
        with (self.folder / f"{name}.log").open("w") as log:
            self._processes[name] = subprocess.Popen(
                self._find_program(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,  # so that Ctrl-C reaches only the demo, which ends the processes in order
            )

    def _find_program(self, command: list[str]) -> list[str]:
        """Return a command with the path of its program."""
        return [str(Path(sys.executable).parent / command[0]), *command[1:]]

    def _first_line(self, name: str) -> str:
        """Wait for the first line of a process, which states its address."""
        process = self._processes[name]
        if process.stdout is None:
            raise AssertionError(f"{name} has no stdout")
        received = b""
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            deadline = time.monotonic() + START_TIMEOUT_S
            while b"\n" not in received:
                if not selector.select(max(0.0, deadline - time.monotonic())):
                    raise RuntimeError(f"{name} did not start within {START_TIMEOUT_S:g} s: {self.log(name)}")
                chunk = os.read(process.stdout.fileno(), 4096)
                if not chunk:
                    raise RuntimeError(f"{name} did not start: {self.log(name)}")
                received += chunk
        return received.decode().splitlines()[0].strip()


class Truth:
    """Follows the file to which a rig writes the true loads."""

    def __init__(self, path: Path) -> None:
        self._file = path.open(encoding="ascii")
        self._rest = ""
        self._times: list[float] = []
        self._loads: list[tuple[float | None, float]] = []

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def skip_to_end(self) -> None:
        """Skip the rows written so far."""
        self._file.seek(0, 2)
        self._file.readline()  # the rest of an unfinished row

    def read(self) -> None:
        """Read the rows that the rig has written since the last call."""
        *lines, self._rest = (self._rest + self._file.read()).split("\n")
        for line in lines:
            seconds, position, force = line.split(",")
            if seconds != "unix_time_s":
                self._times.append(float(seconds))
                self._loads.append((float(position) if position else None, float(force)))

    def at(self, unix_s: float) -> tuple[float | None, float] | None:
        """Return position in mm (None if nothing touched) and force in N at a time; None if no row covers it."""
        index = bisect.bisect_right(self._times, unix_s) - 1
        if index < 0 or unix_s > self._times[-1] + 0.02:
            return None
        return self._loads[index]

    def steady(self, unix_s: float, seconds: float) -> bool:
        """Return whether the load was the same for `seconds` before a time and shortly after it.

        The rig may be suspended for a while, so a gap in its rows counts as unsteady.
        """
        first = bisect.bisect_right(self._times, unix_s - seconds) - 1
        last = bisect.bisect_right(self._times, unix_s)
        if first < 0 or last >= len(self._times):
            return False
        times, loads = self._times[first : last + 1], self._loads[first : last + 1]
        return max(b - a for a, b in pairwise(times)) < TRUTH_GAP_S and all(load == loads[0] for load in loads)
