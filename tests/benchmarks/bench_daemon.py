"""Processor time of the daemon over Modbus TCP, beside a bare loop that only reads and sends."""

import asyncio
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from daemon.devices import pymodbus_server
from daemon.process import started
from daemon.service import TOKEN, Service, serving
from support.programs.processes import processor_s
from support.surfaces import configs

SECONDS = 5.0
CHANNELS = (0, 1, 2, 3)
RATE_HZ = 200
COUNTS = [20_000] * len(CHANNELS)
TURNS = 3

POLL_LOOP = """
import asyncio, sys, time
import aiohttp
from pymodbus.client import AsyncModbusTcpClient

PORT, URL, TOKEN, PERIOD_S, IN_BATCH = int(sys.argv[1]), sys.argv[2], sys.argv[3], float(sys.argv[4]), 4


async def main():
    client = AsyncModbusTcpClient("127.0.0.1", port=PORT)
    await client.connect()
    headers = {"Authorization": "Bearer " + TOKEN}
    names = ["s1", "s2", "s3", "s4"]
    async with aiohttp.ClientSession(headers=headers) as session:
        sequence, due_s, waiting = 1, time.monotonic(), []
        while True:
            due_s += PERIOD_S
            await asyncio.sleep(due_s - time.monotonic())
            answer = await client.read_input_registers(0, count=4, device_id=1)
            deflection_mm = [4.5 - 0.0001 * count - 2.5 for count in answer.registers]
            sample = {"sequence": sequence, "acquired_unix_us": time.time_ns() // 1000, "quality": ["good"] * 4}
            waiting.append(sample | {"deflection_mm": deflection_mm})
            sequence += 1
            if len(waiting) == IN_BATCH:
                body = {"boot_id": "bare-loop", "channels": names, "newest_age_ms": 0.0, "samples": waiting}
                waiting = []
                async with session.post(URL, json=body) as response:
                    await response.read()


asyncio.run(main())
"""
"""The least that reads over Modbus TCP and sends batches of 20 ms as JSON: no filter, no tare, no log."""


def run() -> list[dict[str, object]]:
    """Return the only row."""
    with tempfile.TemporaryDirectory() as folder:
        return [asyncio.run(beside_a_loop(Path(folder)))]


async def used(pid: int) -> float:
    """Return the share of a core that a process uses."""
    before_s = processor_s(pid)
    await asyncio.sleep(SECONDS)
    return (processor_s(pid) - before_s) / SECONDS


async def of_loop(code: str, *arguments: str) -> float:
    """Return the share of a core that a Python program uses."""
    process = await asyncio.create_subprocess_exec(sys.executable, "-c", code, *arguments)
    try:
        await asyncio.sleep(2)
        return await used(process.pid)
    finally:
        process.kill()
        await process.wait()


async def beside_a_loop(folder: Path) -> dict[str, object]:
    """Measure in turns with the bare loop; both poll the same server and send to the same service."""
    shares, loops = [], []
    async with serving(Service()) as service, pymodbus_server(COUNTS) as port:
        text = configs.surface(source=configs.tcp(port), rate_hz=float(RATE_HZ), registers=CHANNELS)
        config = configs.write(folder, text, url=service.url)
        for _ in range(TURNS):
            begin = len(service.samples())
            async with started("run", config) as daemon:
                await service.until(begin + RATE_HZ, within_s=60)
                shares.append(await used(daemon.pid))
                await daemon.stop()
            begin = len(service.samples("bare"))
            loops.append(
                await of_loop(POLL_LOOP, str(port), f"{service.url}/surfaces/bare/samples", TOKEN, str(1 / RATE_HZ))
            )
            assert len(service.samples("bare")) - begin > SECONDS * RATE_HZ / 2, "the bare loop did not send"
    share, loop = sorted(shares)[TURNS // 2], sorted(loops)[TURNS // 2]
    return {
        "name": f"daemon at {RATE_HZ} Hz, 4 channels, Modbus TCP: over a bare pymodbus and aiohttp loop",
        "value": share / loop,
        "unit": "processor time over processor time",
        "goal": "at most 1.2",
        "daemon, %": share * 100,
        "loop, %": loop * 100,
    }
