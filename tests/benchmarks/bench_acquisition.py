"""Acquisition: polls against a bare pymodbus loop, jitter, and the delay from a device to the service."""

import asyncio
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import aclosing, asynccontextmanager
from pathlib import Path
from time import monotonic, perf_counter

from free_ports import free_port

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient

from daemon import configs
from daemon.devices import pymodbus_server
from daemon.lines import joined_terminals
from daemon.process import started
from daemon.service import Service, serving
from daemon.sessions import polled

POLLS, TURNS = 1500, 3
NEVER_IN_TIME_HZ = 1e6
"""Far beyond what a configuration may ask for: every poll begins at once."""
JITTER_HZ, JITTER_POLLS = 200.0, 2000
STEPS = 100
SERVER = Path(__file__).parent.parent / "daemon" / "libmodbus_server.c"


def run() -> list[dict[str, object]]:
    """All of them."""
    with tempfile.TemporaryDirectory() as folder:
        server = compiled_server(Path(folder))
        rows = asyncio.run(tcp_polls(server)) + asyncio.run(rtu_polls(server))
        rows += asyncio.run(jitter(server))
        return rows + asyncio.run(delay(Path(folder)))


def compiled_server(folder: Path) -> Path:
    """Compile the server of the tests: the same device for all who poll, in a process of its own."""
    flags = subprocess.check_output(["pkg-config", "--cflags", "--libs", "libmodbus"], text=True).split()
    subprocess.run(["gcc", "-O2", "-std=gnu11", "-o", folder / "server", SERVER, *flags], check=True)
    return folder / "server"


@asynccontextmanager
async def device(server: Path, *arguments: str) -> AsyncIterator[None]:
    """Run the server for a block."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(server, *arguments, stdin=pipe, stdout=pipe)
    try:
        assert process.stdout is not None
        assert await process.stdout.readline() == b"ready\n"
        yield
    finally:
        process.kill()
        await process.wait()


async def ours(table: str) -> float:
    """Return polls per second of our source, one after the other."""
    source, taken = polled(table, [0, 1, 2, 3], 1.0), 0
    source._rate_hz = NEVER_IN_TIME_HZ
    async with aclosing(source.readings()) as stream:
        await anext(stream)
        begin_s = perf_counter()
        async for readings in stream:
            taken += len(readings)
            if taken >= POLLS:
                break
    return taken / (perf_counter() - begin_s)


async def bare(client: AsyncModbusTcpClient | AsyncModbusSerialClient) -> float:
    """Return polls per second of a loop that does nothing but ask."""
    await client.connect()
    await client.read_input_registers(0, count=4, device_id=1)
    begin_s = perf_counter()
    for _ in range(POLLS):
        await client.read_input_registers(0, count=4, device_id=1)
    took_s = perf_counter() - begin_s
    client.close()
    return POLLS / took_s


async def tcp_polls(server: Path) -> list[dict[str, object]]:
    """Modbus TCP, in turns."""
    port, mine, theirs = free_port(), [], []
    table = f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = 2000'
    async with device(server, "tcp", str(port)):
        for _ in range(TURNS):
            mine.append(await ours(table))
            theirs.append(await bare(AsyncModbusTcpClient("127.0.0.1", port=port, timeout=2)))
    return [ratio("Modbus TCP polls over a bare pymodbus loop", mine, theirs, "at least 0.9")]


async def rtu_polls(server: Path) -> list[dict[str, object]]:
    """Modbus RTU over joined pseudo-terminals, in turns, with and without the silence between frames."""
    rows = []
    for name, silence in (("silence of the standard", ""), ("no silence", "\nsilence_ms = 0")):
        with joined_terminals() as (near, far):
            mine, theirs = [], []
            table = f'kind = "modbus-rtu"\nport = "{near}"\ntimeout_ms = 2000{silence}'
            async with device(server, "rtu", far):
                for _ in range(TURNS):
                    mine.append(await ours(table))
                    theirs.append(await bare(AsyncModbusSerialClient(near, baudrate=115_200, timeout=2)))
        rows.append(ratio(f"Modbus RTU polls over a bare pymodbus loop, {name}", mine, theirs, "at least 0.9"))
    return rows


def ratio(name: str, mine: list[float], theirs: list[float], goal: str) -> dict[str, object]:
    """Return a row of medians."""
    one, other = float(np.median(mine)), float(np.median(theirs))
    return {"name": name, "value": one / other, "unit": "polls/s over polls/s", "goal": goal, "polls/s": one}


async def jitter(server: Path) -> list[dict[str, object]]:
    """How far from their slots readings are taken."""
    port = free_port()
    source = polled(f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}', [0, 1, 2, 3], JITTER_HZ)
    stamps: list[float] = []
    async with device(server, "tcp", str(port)), aclosing(source.readings()) as stream:
        async for readings in stream:
            stamps += [reading.monotonic_s for reading in readings]
            if len(stamps) >= JITTER_POLLS:
                break
    phase = np.array(stamps) * JITTER_HZ % 1.0
    off_ms = (np.angle(np.exp(2j * np.pi * (phase - np.median(phase)))) / (2 * np.pi) / JITTER_HZ) * 1e3
    off_ms = np.abs(off_ms - np.median(off_ms))
    return [
        {"name": f"jitter of polls at {JITTER_HZ:g} Hz, p{q}", "value": float(np.percentile(off_ms, q)), "unit": "ms"}
        for q in (50, 99)
    ]


async def delay(folder: Path) -> list[dict[str, object]]:
    """From a step at the device to the first sample at the service that is past half of it."""
    changed_s = [0.0]
    high = [False]

    async def action(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[:2] = [20_000 - 5000 * high[0]] * 2

    delays = []
    async with serving(Service()) as service, pymodbus_server([20_000, 20_000], action) as port:
        config = configs.write(folder, configs.surface(source=configs.tcp(port)), url=service.url)
        config.write_text(config.read_text().replace("batch_ms = 20", "batch_ms = 1"))
        async with started("run", config) as daemon:
            await service.until(200, within_s=60)
            for _ in range(STEPS):
                await asyncio.sleep(float(np.random.default_rng().uniform(0.08, 0.1)))
                known, changed_s[0], high[0] = len(service.batches), monotonic(), not high[0]
                while True:
                    await service.until(len(service.samples()) + 1)
                    fresh = [(b, at_s) for _, b, at_s in service.batches[known:]]
                    past = [
                        at_s
                        for batch, at_s in fresh
                        if any(((s.deflection_mm[0] or 0.0) < -0.25) == high[0] for s in batch.samples)
                    ]
                    if past:
                        delays.append(past[0] - changed_s[0])
                        break
            await daemon.stop()
    filter_ms = 1e3 * (0.5 / 200 + 1 / 200)  # half a period until the next poll, one more until two of four are new
    return [
        {
            "name": f"step at the device to half of it at the service, p{q}",
            "value": float(np.percentile(delays, q)) * 1e3,
            "unit": "ms",
            "sampling and filter alone, ms": filter_ms,
        }
        for q in (50, 99)
    ]


if __name__ == "__main__":
    for row in run():
        print(row)
