"""The Modbus TCP client on libmodbus: compiled once, and what it reads."""

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from contact_registers import USED
from line import Line
from parts import require
from toolchain import made_once, run
from waiting import wait_until

SOURCE = Path(__file__).with_name("libmodbus_client.c")
POLLS, PAUSE_US = 10_000_000, 5000


@dataclass(frozen=True)
class Poll:
    """What one request gave."""

    words: list[int]
    """The registers of the block."""
    floats: list[float]
    """Its figures and the constant, as libmodbus decodes them, in the order of their addresses."""


def modbus_port(line: Line) -> int:
    """Return the port of the Modbus TCP server of a service, which opens after the address of HTTP is stated."""
    address = re.compile(r"Modbus TCP server: listening on 127\.0\.0\.1:(\d+)")
    wait_until(lambda: address.search(line.log("service")) is not None)
    return int(address.findall(line.log("service"))[0])


def compiled(factory: pytest.TempPathFactory) -> Path:
    """Return the program, built in whichever test process came first."""
    pkg_config, compiler = require("pkg-config", "pkg-config"), require("gcc", "gcc")
    require("mbpoll", "mbpoll libmodbus-dev")

    def make(folder: Path) -> None:
        flags = run(pkg_config, "--cflags", "--libs", "libmodbus").split()
        run(compiler, "-std=gnu11", "-Wall", "-o", folder / "client", SOURCE, *flags)

    return made_once(factory, "libmodbus-client", make) / "client"


@contextmanager
def polls(program: Path, port: int, word_order: str = "big") -> Iterator[Iterator[Poll]]:
    """Poll the first block of a server again and again; gives what each poll gave."""
    order = {"big": "abcd", "little": "cdab"}[word_order]
    command = [str(program), str(port), "0", str(USED), str(POLLS), str(PAUSE_US), order]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield map(_poll, process.stdout)
        finally:
            process.kill()


def _poll(line: str) -> Poll:
    values = line.split()
    return Poll([int(one) for one in values[:USED]], [float(one) for one in values[USED:]])
