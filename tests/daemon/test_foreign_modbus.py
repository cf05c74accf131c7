"""Modbus with programs that are not ours: a server on libmodbus, and mbpoll asking the rig."""

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from beamtouch_daemon.sources.polled import PolledSource
from beamtouch_daemon.sources.reading import first_readings
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.rig.loads import Load
from beamtouch_models.rig.surface import VirtualSurface
from beamtouch_models.scene import load_scene
from example_scenes import SCENES
from forked_line import rig
from free_ports import free_port
from parts import require
from toolchain import made_once, run

from .lines import joined_terminals
from .sessions import polled, source_in

pytestmark = pytest.mark.anyio

SERVER = Path(__file__).with_name("libmodbus_server.c")
LINE = ("-b", "115200", "-P", "none")


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The server, compiled."""
    pkg_config, compiler = require("pkg-config", "pkg-config"), require("gcc", "gcc")
    require("mbpoll", "mbpoll libmodbus-dev")

    def make(folder: Path) -> None:
        flags = run(pkg_config, "--cflags", "--libs", "libmodbus").split()
        run(compiler, "-std=gnu11", "-Wall", "-o", folder / "server", SERVER, *flags)

    return made_once(tmp_path_factory, "libmodbus-server", make) / "server"


@contextmanager
def serving(program: Path, *arguments: str) -> Iterator[None]:
    with subprocess.Popen([program, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield
        finally:
            process.kill()


def of(table: str, registers: list[int]) -> PolledSource:
    return polled(table, registers, 100.0)


async def test_a_libmodbus_server_is_read_over_tcp(server: Path) -> None:
    port = free_port()
    table = f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = 2000'

    with serving(server, "tcp", str(port)):
        inputs, holding, wide = [
            await first_readings(of(table, [3, 0, 9]), 100),
            await first_readings(of(f"{table}\nfunction = 3", [3, 0, 9]), 50),
            await first_readings(source_in({}, table, ["register = 4\ntype = 'u32'\n", "register = 1"], 100.0), 50),
        ]
    assert {reading.counts for reading in inputs} == {(1003, 1000, 1009)}
    assert {reading.counts for reading in holding} == {(2003, 2000, 2009)}
    assert {reading.counts for reading in wide} == {(1004 * 65536 + 1005, 1001)}


async def test_a_libmodbus_server_is_read_over_rtu(server: Path) -> None:
    with joined_terminals() as (ours, theirs), serving(server, "rtu", theirs):
        table = f'kind = "modbus-rtu"\nport = "{ours}"\ntimeout_ms = 1000'
        together = await first_readings(of(table, [3, 0, 9]), 100)
        bridged = await first_readings(of(f"{table}\nbridge_registers = 9\nfunction = 3", [3, 0, 9]), 50)
    assert {reading.counts for reading in together} == {(1003, 1000, 1009)}
    assert {reading.counts for reading in bridged} == {(2003, 2000, 2009)}


@pytest.mark.parametrize("kind", ["modbus-tcp", "modbus-rtu"])
def test_mbpoll_reads_the_rig(bench: ModelFile, bench_model: Path, tmp_path: Path, kind: str) -> None:
    mbpoll = require("mbpoll", "mbpoll")
    where = "127.0.0.1:0" if kind == "modbus-tcp" else tmp_path / "line"
    with rig(SCENES / "bench.toml", bench_model, f"--{kind}", where, "--by-hand", "--no-ringing") as beam:
        beam.put("200 20")
        target = ["tcp", "-p", beam.place, "127.0.0.1"] if kind == "modbus-tcp" else ["rtu", *LINE, beam.place]
        said = run(mbpoll, "-a", "1", "-t", "3", "-r", "1", "-c", "4", "-1", "-o", "5", "-m", *target)
    counts = [int(count) for count in re.findall(r"^\[\d\]:\s+(\d+)", said, re.MULTILINE)]
    scene, _ = load_scene(SCENES / "bench.toml")
    surface = VirtualSurface(scene, bench.metadata, seed=1)
    noise_counts = bench.metadata.noise.reading_mm / abs(surface.sensor.gain_mm_per_count)
    expected = surface.counts(Load(200.0, 20.0), 0.0)
    assert len(counts) == 4
    assert max(expected) - min(expected) > 100 * noise_counts
    assert all(abs(count - other) < 10 * noise_counts for count, other in zip(counts, expected, strict=True))
