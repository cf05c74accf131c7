"""A device that is not there is tried again after a pause: a bus, a network and a processor have other work."""

import asyncio
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from time import monotonic

import pytest

from support.surfaces import configs

from .devices import rtu_units
from .lines import Watch, terminal
from .process import started
from .service import Service, serving
from .waits import until

pytestmark = pytest.mark.anyio

TIMEOUT_S = 0.1
SESSION_PAUSES_S = (0.1, 0.2, 0.4, 0.5, 0.5, 0.5)
"""Between the sessions of a source that ends at once."""
GIVEN_UP_AFTER = 3
NO_BOOT = "from beamtouch_daemon.sources import traffic; traffic.BOOT_S = 0.0"
"""Opening the port resets no device."""


QUESTION_S = 4
"""How long a name server is waited for, which is longer than the test looks."""
SLOW_NAME_SERVER = f"""
import socket, time

def getaddrinfo(host, *arguments, **options):
    if host != "module.plant":
        return asked(host, *arguments, **options)
    with open("questions", "a") as file:
        file.write("?")
    time.sleep({QUESTION_S})
    raise socket.gaierror(socket.EAI_AGAIN, "no answer")

asked, socket.getaddrinfo = socket.getaddrinfo, getaddrinfo
"""


async def shortest_s(count: Callable[[], int], number: int) -> float:
    """Wait for so many attempts after the first; return how long they took [s]. A busy machine only takes longer."""
    await until(lambda: count() >= 1)
    begun, begun_s = count(), monotonic()
    await until(lambda: count() >= begun + number)
    return monotonic() - begun_s


async def test_a_port_that_cannot_be_used_is_opened_ever_more_rarely(tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    port.write_text("no serial port")
    watch, opened = Watch(str(port)), 0

    def count() -> int:
        nonlocal opened
        opened += sum(watch.openings())
        return opened

    async with serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=configs.serial(str(port))), url=service.url)
        async with started("run", config):
            number = len(SESSION_PAUSES_S)
            assert await shortest_s(count, number) > sum(SESSION_PAUSES_S) / 2


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "A unit that does not answer is asked again after 13 timeouts.",
)
@pytest.mark.parametrize("boots", [True, False])
async def test_units_of_which_none_answers_leave_the_bus_alone_for_thirteen_timeouts(
    tmp_path: Path, *, boots: bool
) -> None:
    """Within a session, while they may boot, and from one session to the next."""
    unanswered: list[int] = []
    with terminal() as line:
        async with rtu_units(line, {}, unanswered), serving(Service()) as service:
            source = f"{configs.rtu(line.path)}\ntimeout_ms = {TIMEOUT_S * 1e3}"
            config = configs.write(tmp_path, configs.surface(source=source, rate_hz=20.0), url=service.url)
            async with started("run", config, code="" if boots else NO_BOOT):
                await until(lambda: len(unanswered) >= GIVEN_UP_AFTER)
                unanswered.clear()
                # One is tried, and fails after its timeout; then there is the pause.
                assert await shortest_s(lambda: len(unanswered), 3) > 3 * 13 * TIMEOUT_S / 1.5


async def test_a_device_that_closes_each_connection_is_connected_to_twice_a_second_at_most(tmp_path: Path) -> None:
    connections = 0

    async def refuse(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal connections
        connections += 1
        with closing(writer):
            pass

    server = await asyncio.start_server(refuse, "127.0.0.1", 0)
    async with server, serving(Service()) as service:
        source = configs.tcp(server.sockets[0].getsockname()[1])
        config = configs.write(tmp_path, configs.surface(source=source), url=service.url)
        async with started("run", config):
            await until(lambda: connections >= GIVEN_UP_AFTER)
            assert await shortest_s(lambda: connections, 4) > 4 * 0.5 / 1.5


async def test_a_name_server_that_does_not_answer_is_asked_once_whatever_the_attempts(tmp_path: Path) -> None:
    source = configs.tcp(502, "module.plant").replace("30_000", "100")
    code = f"import os; os.chdir({str(tmp_path)!r}){SLOW_NAME_SERVER}"
    async with started("run", configs.write(tmp_path, configs.surface(source=source)), code=code) as daemon:
        await daemon.said("module.plant does not resolve (the name server does not answer)")
        await asyncio.sleep(sum(SESSION_PAUSES_S[:4]) + 4 * TIMEOUT_S)
        assert (tmp_path / "questions").read_text() == "?"
