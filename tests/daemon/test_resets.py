"""Devices that their own port resets, that boot for seconds, print text or hang: they are reached, or described."""

import asyncio
import itertools
import json
import os
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from pathlib import Path

import pytest

from support.programs.simulated_board import Board
from support.surfaces import configs

from .devices import RestingUnit, SerialDevice, rtu_units
from .lines import RebootingTerminal, Terminal, Watch, rebooting_terminal, terminal
from .process import Outcome, command, started, summary_of
from .service import Service, serving
from .waits import until

pytestmark = pytest.mark.anyio

DEAF_S = 1.5
BOOTS_S = 2.9
SLOW_S = 5.0
LOADER = b"\r\noptiboot 8.3\r\nstarting the application\r\n"
ONE_SETTING = ("--units", "1-3", "--baud", "9600", "--parity", "none")


@asynccontextmanager
async def rtu_device(boots_s: float, prints: bytes = b"") -> AsyncIterator[RebootingTerminal]:
    """A unit that is deaf for a while after each opening of its port."""
    with rebooting_terminal(boots_s, prints) as line:
        async with rtu_units(line, {1: RestingUnit()}):
            yield line


@asynccontextmanager
async def booting_board(boots_s: float, prints: bytes = b"") -> AsyncIterator[RebootingTerminal]:
    """A board that boots after each opening of its port, and says so at the end."""
    with rebooting_terminal(boots_s, prints) as line:
        Booting(line)
        yield line


class Booting(SerialDevice):
    """A board that has another boot id after each boot, and gives the counts of a beam at rest."""

    def __init__(self, line: RebootingTerminal) -> None:
        super().__init__(line)
        self.boots = 0
        line.reset = self._boot

    def _boot(self) -> None:
        self.boots += 1
        self.reset(self.boots + 1)

    def counts(self, _sequence: int) -> tuple[int, ...]:
        return (20_000, 20_000)


DEVICES = {
    "unit, deaf for 1.5 s": (partial(rtu_device, DEAF_S), configs.rtu),
    "unit, deaf for 5 s": (partial(rtu_device, SLOW_S), configs.rtu),
    "board, boots for 2.9 s": (partial(booting_board, BOOTS_S), configs.serial),
    "board, boots for 5 s and prints text": (partial(booting_board, SLOW_S, LOADER), configs.serial),
    "board, prints other bytes": (partial(booting_board, BOOTS_S, bytes(range(1, 256))), configs.serial),
}
every_device = pytest.mark.parametrize("device", list(DEVICES))


async def assert_done(line: RebootingTerminal, *words: str | Path) -> Outcome:
    """Run a command; it succeeds, and opens the port once."""
    opened = line.opened
    outcome = await command(*words)
    assert (outcome.code, line.opened - opened) == (0, 1), outcome
    return outcome


@every_device
async def test_check_waits_until_the_device_has_booted(device: str, tmp_path: Path) -> None:
    make, source = DEVICES[device]
    async with make() as line:
        await assert_done(line, "check", configs.write(tmp_path, configs.surface(source=source(line.path))))


@pytest.mark.promise("docs/how-to/adc-module.md", "`scan` waits 8 s for a board that boots, then asks again.")
@every_device
async def test_scan_finds_the_device_with_one_opening(device: str) -> None:
    make, _ = DEVICES[device]
    async with make() as line:
        found = json.loads((await assert_done(line, "scan", line.path, *ONE_SETTING, "--json")).out)
    assert [unit["source"]["unit"] for unit in found["units"]] == ([1] if "unit" in device else [])
    assert (found["board"] is not None) == ("board" in device)


@pytest.mark.parametrize("device", ["unit, deaf for 1.5 s", "board, boots for 2.9 s"])
async def test_tare_and_record_wait_for_it_too(device: str, tmp_path: Path) -> None:
    make, source = DEVICES[device]
    # Less than the unit is deaf for, and time for the answers of a starved machine.
    patient = "\ntimeout_ms = 1_000" if "unit" in device else ""
    async with make() as line:
        config = configs.write(tmp_path, configs.surface(source=source(line.path) + patient))
        await assert_done(line, "tare", config)
        options = ("--at", "100", "5", "--accept", "--seconds", "0.2")
        async with started("record", config, "-o", tmp_path / "loads.csv", *options) as recording:
            await recording.said("): ")
            recording.answer("")
            outcome = await recording.end()
    assert outcome.code == 0, outcome.err


@every_device
async def test_a_daemon_that_starts_opens_the_port_once_and_loses_nothing(device: str, tmp_path: Path) -> None:
    make, source = DEVICES[device]
    async with make() as line, serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=source(line.path)), url=service.url)
        async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
            await service.until(5)
            outcome = await daemon.stop()
    assert line.opened == 1
    assert "trying again" not in outcome.err
    # Those of a second would be 200. A busy machine misses some.
    assert summary_of(tmp_path)["bench"]["readings_lost"] < 100


SHORT = "from beamtouch_daemon.sources import traffic; traffic.BOOT_S = 0.5"
"""Code by which a device is expected to boot quickly."""


@pytest.mark.parametrize("device", ["unit, deaf for 5 s", "board, boots for 5 s and prints text"])
async def test_a_device_that_boots_longer_than_expected_is_read_as_the_port_stays_open(
    device: str, tmp_path: Path
) -> None:
    make, source = DEVICES[device]
    async with make() as line, serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=source(line.path)), url=service.url)
        async with started("run", config, code=SHORT) as daemon:
            await service.until(5)
            outcome = await daemon.stop()
    assert line.opened == 1
    (complaint,) = [text for text in outcome.err.splitlines() if "trying again" in text]
    assert ("optiboot" in complaint) == (device.startswith("board"))


async def test_check_that_waits_keeps_the_port_open_between_its_attempts(tmp_path: Path) -> None:
    async with booting_board(SLOW_S) as line:
        config = configs.write(tmp_path, configs.surface(source=configs.serial(line.path)))
        outcome = await command("check", config, "--wait", "6", code=SHORT)
    assert line.opened == 1
    assert "waiting: bench: " in outcome.err
    assert "good" in outcome.out  # the service is not there


class Firmware:
    """The reference firmware on a simulated chip, which each opening of its line resets."""

    def __init__(self, line: Path, commands: asyncio.StreamWriter) -> None:
        self.line = line
        self.opened = 0
        self.watch = Watch(str(line))
        self._commands = commands

    def reset(self) -> None:
        """Press its button."""
        self._commands.write(b"reset\n")

    def notice(self) -> None:
        """Look who has opened the line."""
        for _ in filter(None, self.watch.openings()):
            self.opened += 1
            self.reset()


@asynccontextmanager
async def firmware(board: Board, folder: Path) -> AsyncIterator[Firmware]:
    """Run the firmware until the end of the block."""
    line = folder / "line"
    words = [*board.command, "--link", str(line), "--eeprom", str(folder / "eeprom")]
    process = await asyncio.create_subprocess_exec(*words, stdin=PIPE, stdout=PIPE)
    assert process.stdin is not None
    assert process.stdout is not None
    await process.stdout.readline()
    process.stdin.write(b"2500 2500 2500 2500\n")
    chip, loop = Firmware(line, process.stdin), asyncio.get_running_loop()
    loop.add_reader(chip.watch.descriptor, chip.notice)
    try:
        yield chip
    finally:
        loop.remove_reader(chip.watch.descriptor)
        os.close(chip.watch.descriptor)
        process.stdin.close()
        assert await process.wait() == 0


async def test_the_firmware_is_read_though_each_opening_resets_it_and_again_after_a_reset_of_its_own(
    board: Board, tmp_path: Path
) -> None:
    async with firmware(board, tmp_path) as chip, serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=configs.serial(str(chip.line))), url=service.url)
        config.write_text(config.read_text().replace("\nrange_mm", "\nadc_bits = 10\nrange_mm"))
        async with started("run", config) as daemon:
            await service.until(50)
            chip.reset()
            await service.until(len(service.samples()) + 50)
            outcome = await daemon.stop()
    assert chip.opened == 1
    assert "the device was reset; trying again" in outcome.err


@pytest.mark.parametrize("kind", ["unit", "board"])
async def test_a_device_that_resets_itself_is_read_again_through_the_same_port(kind: str, tmp_path: Path) -> None:
    with rebooting_terminal(1.0, LOADER) as line:
        async with AsyncExitStack() as stack:
            device = Booting(line) if kind == "board" else None
            if device is None:
                await stack.enter_async_context(rtu_units(line, {1: RestingUnit()}))
            service = await stack.enter_async_context(serving(Service()))
            source = configs.serial(line.path) if device else configs.rtu(line.path)
            config = configs.write(tmp_path, configs.surface(source=source), url=service.url)
            daemon = await stack.enter_async_context(started("run", config))
            await service.until(50)
            for _ in range(2):
                if device is not None:
                    device.stop()
                line.boot()
                await until(lambda: not line.is_booting)
                await service.until(len(service.samples()) + 20)
            assert (await daemon.stop()).code == 0
    assert line.opened == 1


@pytest.mark.promise("docs/how-to/several-surfaces.md", "The port stays open as long as it works.")
async def test_surfaces_that_share_a_bus_share_its_open_port(tmp_path: Path) -> None:
    with rebooting_terminal(DEAF_S) as line:
        async with rtu_units(line, {1: RestingUnit(), 2: RestingUnit()}), serving(Service()) as service:
            bus = f"{configs.rtu(line.path)}\ntimeout_ms = 5_000"  # as long as a starved machine takes for an answer
            sources = {"one": bus, "two": f"{bus}\nunit = 2"}
            surfaces = [configs.surface(name, source) for name, source in sources.items()]
            config = configs.write(tmp_path, *surfaces, url=service.url)
            await assert_done(line, "check", config)
            async with started("run", config) as daemon:
                await asyncio.gather(*(service.until(20, name) for name in sources))
                assert (await daemon.stop()).code == 0
    assert line.opened == 2


async def test_an_adapter_that_hangs_is_opened_again(tmp_path: Path) -> None:
    hangs = "from beamtouch_daemon.sources import traffic; traffic.SILENT_S = 2.0; traffic.BOOT_S = 0.5"
    with rebooting_terminal(0.5) as line:
        device = Booting(line)
        async with serving(Service()) as service:
            config = configs.write(tmp_path, configs.surface(source=configs.serial(line.path)), url=service.url)
            async with started("run", config, code=hangs) as daemon:
                await service.until(50)
                line.hang()
                while line.opened < 2:  # what was on its way before the line hung may come after it
                    await service.until(len(service.samples()) + 1)
                await service.until(len(service.samples()) + 50)
                assert (await daemon.stop()).code == 0
    assert (line.opened, device.boots) == (2, 2)


async def test_a_port_that_is_closed_leaves_dtr_up_so_that_the_next_command_resets_nothing(tmp_path: Path) -> None:
    with rebooting_terminal(1.0, spares=True) as line:
        device = Booting(line)
        config = configs.write(tmp_path, configs.surface(source=configs.serial(line.path)))
        for words in (("check", config), ("tare", config), ("scan", line.path, *ONE_SETTING)):
            await assert_done(line, *words)
    assert device.boots == 1


SAID = {
    "not a byte": (b"", "the port is open, but not a byte came; check supply and wiring"),
    "bytes": (bytes(range(200, 256)), "the port is open, and 56 bytes came, none of them a frame; check baud"),
    "text": (LOADER, "the device prints text: 'optiboot 8.3 starting the application'"),
}


@pytest.mark.parametrize("kind", list(SAID))
@pytest.mark.parametrize("source", [configs.rtu, configs.serial], ids=["rtu", "serial"])
async def test_what_a_device_sent_in_place_of_answers_is_said(
    kind: str, source: Callable[[str], str], tmp_path: Path
) -> None:
    prints, said = SAID[kind]
    with rebooting_terminal(60.0, prints) as line:
        outcome = await command("check", configs.write(tmp_path, configs.surface(source=source(line.path))), code=SHORT)
    assert outcome.code == 1
    assert said in outcome.complaint()


@pytest.mark.parametrize(
    ("prints", "said"),
    [
        (b"", "nothing answers: check power, wiring (A and B swapped?)"),
        (bytes(range(200, 256)), "nothing answers, but bytes came that are no answer: 56 bytes at 9600 baud"),
        (LOADER, "nothing answers, but at 9600 baud, parity none, the device prints text: 'optiboot 8.3 starting"),
    ],
    ids=["nothing", "bytes", "text"],
)
async def test_scan_blames_no_cable_if_the_device_spoke(prints: bytes, said: str) -> None:
    with rebooting_terminal(60.0, prints) as line:
        outcome = await command("scan", line.path, *ONE_SETTING, code=SHORT)
    assert outcome.code == 1
    assert said in outcome.err.splitlines()[-1]


async def test_text_that_repeats_with_other_lengths_fills_no_log(tmp_path: Path) -> None:
    with terminal() as line:
        writing = asyncio.create_task(babble(line))
        async with serving(Service()) as service:
            config = configs.write(tmp_path, configs.surface(source=configs.rtu(line.path)), url=service.url)
            async with started("run", config, code=SHORT) as daemon:
                await daemon.said("trying again")
                await asyncio.sleep(5.0)  # for several attempts
                outcome = await daemon.stop()
        writing.cancel()
    assert "trying again" not in outcome.err


async def babble(line: Terminal) -> None:
    """Send bytes that are no frames, for ever."""
    for number in itertools.count():
        line.write(bytes([200 + number % 50]))
        await asyncio.sleep(0.01)
