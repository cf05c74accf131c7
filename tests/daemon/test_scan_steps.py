"""A scan step by step, in the process of the test: who is asked what, what counts as an answer, and what is said."""

import argparse
import asyncio
import json
import socket
from collections.abc import Callable, Sequence

import pytest

from beamtouch_common.errors import InputError
from beamtouch_daemon.commands import scan as scanning
from beamtouch_daemon.commands.scan import Scan
from beamtouch_daemon.commands.scan_report import Source
from beamtouch_daemon.sources import board, traffic
from beamtouch_daemon.sources.reading import NoAnswerError, SourceError
from beamtouch_daemon.sources.registers import Block, RegisterAnswer
from beamtouch_daemon.sources.serial_port import SerialPort
from support.network.free_ports import free_port

from .devices import Pieces, RegisterUnit, StampingUnit, pymodbus_server, rtu_units
from .lines import terminal

pytestmark = pytest.mark.anyio

Answers = dict[int, Sequence[RegisterAnswer | None]]
"""What a unit answers to each function in turn; None: nothing."""
GIVEN, LACKING, BUSY = RegisterAnswer((7,)), RegisterAnswer(exception=2), RegisterAnswer(exception=6)
ABSENT = RegisterAnswer(exception=11)
SOURCE: Source = {"kind": "modbus-rtu", "port": "/dev/x"}


def scan_of(target: str, **options: object) -> Scan:
    defaults = {"units": None, "baud": None, "parity": None, "timeout_ms": None, "json": False}
    return Scan(argparse.Namespace(target=target, **defaults | options))


@pytest.mark.parametrize(
    ("answers", "found", "asked"),
    [
        ({4: [GIVEN], 3: [GIVEN]}, {4: GIVEN, 3: GIVEN}, [4, 3]),
        ({4: [GIVEN], 3: [LACKING]}, {4: GIVEN, 3: LACKING}, [4, 3]),
        ({4: [None], 3: [None]}, {}, [4, 3]),
        ({4: [ABSENT], 3: [None]}, {}, [4, 3]),
        ({4: [RegisterAnswer(exception=4)], 3: [RegisterAnswer(exception=10)]}, {}, [4, 3]),
        # What is silent, or refused for now, is asked again once the unit is known to be there.
        ({4: [None, GIVEN], 3: [GIVEN]}, {4: GIVEN, 3: GIVEN}, [4, 3, 4]),
        ({4: [GIVEN], 3: [None, None]}, {4: GIVEN}, [4, 3, 3]),
        ({4: [BUSY, GIVEN], 3: [GIVEN]}, {4: GIVEN._replace(refusals=(6,)), 3: GIVEN}, [4, 3, 4]),
        ({4: [BUSY, BUSY, GIVEN], 3: [GIVEN]}, {4: GIVEN._replace(refusals=(6, 6)), 3: GIVEN}, [4, 3, 4, 4]),
        ({4: [ABSENT, GIVEN], 3: [GIVEN]}, {4: GIVEN._replace(refusals=(11,)), 3: GIVEN}, [4, 3, 4]),
    ],
)
async def test_a_unit_is_asked_for_the_first_register_of_each_kind(
    answers: Answers, found: dict[int, RegisterAnswer], asked: list[int]
) -> None:
    left, seen = {function: list(each) for function, each in answers.items()}, list[int]()

    async def ask(unit: int, block: Block) -> RegisterAnswer:
        assert (unit, block.first, block.count) == (7, 0, 1)
        seen.append(block.function)
        if (answer := left[block.function].pop(0)) is None:
            raise NoAnswerError("silent")
        return answer

    assert await scanning._ask_unit(7, ask) == found
    assert seen == asked


async def test_units_that_answer_are_found_and_said_and_so_is_how_far_the_scan_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 100.0
    monkeypatch.setattr(scanning, "monotonic", lambda: now_s)

    async def ask(unit: int, block: Block) -> RegisterAnswer:
        nonlocal now_s
        now_s += 0.7
        if unit not in (3, 9):
            raise NoAnswerError("silent")
        if unit == 9:
            return LACKING
        return GIVEN._replace(exception=2, registers=()) if block.function == 4 else GIVEN

    found = scan_of("/dev/x")
    await found._ask_units("9600 baud", SOURCE, range(1, 15), ask)
    assert [(unit.source, unit.functions, unit.refusals) for unit in found.findings.units] == [
        (SOURCE | {"unit": 3, "function": 3}, [3], []),
        (SOURCE | {"unit": 9, "function": 4}, [], []),
    ]
    await found._ask_units("19200 baud", SOURCE, [1], ask)
    assert capsys.readouterr().err.splitlines() == [
        "9600 baud: unit 3 answers",
        "9600 baud: 4 of 14 units asked, the last is 4",
        "9600 baud: 8 of 14 units asked, the last is 8",
        "9600 baud: unit 9 answers",
        "9600 baud: 12 of 14 units asked, the last is 12",
        "19200 baud: nothing",
    ]


async def test_a_unit_that_refuses_now_and_then_is_found_with_its_refusals() -> None:
    async def ask(_unit: int, block: Block) -> RegisterAnswer:
        return ABSENT if block.function == 3 else answers.pop(0)

    answers, found = [BUSY, RegisterAnswer(exception=5), GIVEN], scan_of("/dev/x")
    await found._ask_units("9600 baud", SOURCE, [7], ask)
    (unit,) = found.findings.units
    assert (unit.functions, unit.refusals) == ([4], [5, 6, 11])


async def test_units_behind_an_address_are_found_with_their_source(capsys: pytest.CaptureFixture[str]) -> None:
    async with pymodbus_server([7, 8]) as port:
        found = scan_of(f"tcp://127.0.0.1:{port}", units=(1, 2), timeout_ms=20_000.5, json=True)
        assert await found.network()
    found.report(is_complete=True)
    told, said = capsys.readouterr()
    source = {"kind": "modbus-tcp", "host": "127.0.0.1", "port": port, "timeout_ms": 20_001, "unit": 1, "function": 4}
    assert json.loads(told)["units"] == [{"source": source, "registers": ["input", "holding"]}]
    target = f"tcp://127.0.0.1:{port}"
    assert said.splitlines() == [f"{target}: Modbus TCP units 1-2; Ctrl-C ends it", f"{target}: unit 1 answers"]


async def test_an_address_that_accepts_connections_and_answers_nothing_is_told_with_what_to_try(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        target = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        found = scan_of(target, units=(1,), timeout_ms=10.0)
        assert await found.network() == (
            f"nothing answers: {target} accepts connections; check the unit numbers of the device, or try --units "
            "1-247 or --timeout-ms 100"
        )
    assert capsys.readouterr().err.splitlines()[1:] == [f"{target}: nothing", f"{target} in RTU frames: nothing"]
    found.report(is_complete=True)
    assert capsys.readouterr().out == ""


async def test_an_address_without_a_device_or_with_settings_of_a_line_is_an_error() -> None:
    port = free_port()
    with pytest.raises(SourceError, match=f"no connection to 127.0.0.1:{port}; is the device on"):
        await scan_of(f"tcp://127.0.0.1:{port}").network()
    for options in ({"baud": (9600,)}, {"parity": ("even",)}):
        with pytest.raises(InputError, match="--baud and --parity are for a serial line; leave them out with tcp://"):
            await scan_of("tcp://127.0.0.1", **options).network()


class Absent(StampingUnit):
    """A unit that is not there, as a gateway says."""

    def __init__(self) -> None:
        super().__init__()
        self.asked = list[int]()
        """Functions of the requests."""

    def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
        self.asked.append(request[1])
        return [(0.0, wrap(bytes([request[0], request[1] | 0x80, 11])))]


class Closing(asyncio.Protocol):
    """A device that ends each connection."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()


class NoBoard:
    """What finds no board, at once."""

    def __init__(self, _port: SerialPort) -> None:
        pass

    async def introduce(self) -> None:
        raise SourceError("no hello")


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let devices boot in no time."""
    monkeypatch.setattr(traffic, "BOOT_S", 0.0)
    monkeypatch.setattr(board, "HELLO_TIMEOUT_S", 0.01)


@pytest.mark.usefixtures("brief")
async def test_a_line_is_tried_with_all_settings_and_each_unit_is_found_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    absent = Absent()
    with terminal() as line:
        async with rtu_units(line, {2: RegisterUnit(8, 0), 3: absent}):
            options = {"units": (2, 3), "baud": (9600, 19_200), "parity": ("none",), "timeout_ms": 30_000.0}
            found = scan_of(line.path, **options)
            await found.line()
    assert [unit.source["baud"] for unit in found.findings.units] == [9600]
    assert absent.asked == [4, 3, 4, 3]
    assert capsys.readouterr().err.splitlines() == [
        f"{line.path}: Modbus RTU units 2-3, and a Beamtouch board; Ctrl-C ends it",
        "9600 baud, parity none: unit 2 answers",
        "19200 baud, parity none: nothing",
    ]


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    ("parities", "said"),
    [
        (
            ("none",),
            "nothing answers: check power, wiring (A and B swapped?) and the address of the device, stop other "
            "masters, or try --units 1-247 or --timeout-ms 50",
        ),
        (("even",), "{path} refuses these line settings, so no Modbus unit was asked; try others"),
    ],
)
async def test_a_line_on_which_nothing_answers_is_told_with_what_to_check(parities: tuple[str, ...], said: str) -> None:
    with terminal() as line:
        found = scan_of(line.path, units=(5,), baud=(9600,), parity=parities, timeout_ms=10.0)
        assert await found.line() == said.format(path=line.path)


async def test_units_that_may_have_booted_are_asked_again(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(traffic, "BOOT_S", 600.0)
    monkeypatch.setattr(scanning, "BoardLine", NoBoard)
    unanswered = list[int]()
    with terminal() as line:
        async with rtu_units(line, {}, unanswered):
            await scan_of(line.path, units=(5,), baud=(9600,), parity=("none",), timeout_ms=10.0).line()
    assert unanswered == [5, 5, 5, 5]
    assert capsys.readouterr().err.splitlines()[1:] == [
        "9600 baud, parity none: nothing",
        "9600 baud: no Beamtouch board",
        "again, because opening the port may have reset them:",
        "9600 baud, parity none: nothing",
    ]


async def test_without_options_the_usual_units_rates_and_parities_are_tried_and_a_board_at_a_megabaud(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scanning, "BoardLine", NoBoard)
    monkeypatch.setattr(traffic, "BOOT_S", 0.0)
    with terminal() as line:
        await scan_of(line.path, timeout_ms=0.1, baud=(115_200,), parity=("none",)).line()
        assert capsys.readouterr().err.startswith(f"{line.path}: Modbus RTU units 1-16, and a Beamtouch board; ")
        await scan_of(line.path, timeout_ms=0.1, units=(1,)).line()
    _, *said = capsys.readouterr().err.splitlines()
    tried = [line.partition(":")[0].replace(" baud", "") for line in said]
    assert tried == [
        "9600, parity none",
        "1000000",  # after the first settings
        *(f"9600, parity {parity}" for parity in ("even", "odd")),
        *(
            f"{baud}, parity {parity}"
            for baud in (19_200, 115_200, 38_400, 57_600)
            for parity in ("none", "even", "odd")
        ),
    ]


@pytest.mark.usefixtures("brief")
async def test_without_a_timeout_that_of_the_sources_counts(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal() as line:
        failure = await scan_of(line.path, units=(1,), baud=(9600,), parity=("none",)).line()
    assert failure.endswith("--timeout-ms 500")  # five times 0.1 s
    capsys.readouterr()
    async with await asyncio.get_running_loop().create_server(Closing, "127.0.0.1", 0) as server:
        target = f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        failure = await scan_of(target).network()
    assert failure.endswith("--timeout-ms 2000")  # ten times 0.2 s
    assert capsys.readouterr().err.startswith(f"{target}: Modbus TCP units 1-16, 0, 255; Ctrl-C ends it\n")


@pytest.mark.usefixtures("brief")
async def test_a_line_that_is_unplugged_meanwhile_is_gone() -> None:
    with terminal() as line:
        line.on_data(lambda _: line.unplug())
        with pytest.raises(SourceError) as raised:
            await scan_of(line.path, units=(5,), baud=(9600,), parity=("none",), timeout_ms=30_000.0).line()
        assert str(raised.value) == f"{line.path} is gone"
