"""The debug log names what is wrong with a line, frame by frame, and says nothing unless it is asked for."""

import asyncio
import logging
import pkgutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

import beamtouch_daemon
from beamtouch_daemon import cli
from beamtouch_daemon.sources import rtu_line
from beamtouch_daemon.sources.frame_diagnosis import describe_received, describe_request, in_hex
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_frames import encode
from support.surfaces import configs

from .devices import Fault, NumberingUnit, Pieces, no_echo, no_fault, pymodbus_server, rtu_units, with_crc
from .lines import terminal
from .process import started
from .service import Service, serving
from .sessions import SourceError, first_readings, source_in, take_across_sessions
from .waits import until

pytestmark = pytest.mark.anyio

SOURCES = "beamtouch_daemon.sources"
TWO = Block(0, 2)
REQUEST = encode(1, TWO)
ANSWER = with_crc(bytes([1, 4, 4, 0, 7, 0, 8]))


async def lines_with(
    words: str,
    fault: Fault,
    caplog: pytest.LogCaptureFixture,
    *,
    units: int = 1,
    echo: Callable[[bytes], Pieces] = no_echo,
    number: int = 1,
) -> list[str]:
    """Read two registers of unit 1 until so many debug lines have the words. The unit there has the number `units`."""
    caplog.set_level(logging.DEBUG, SOURCES)

    def found() -> list[str]:
        debug = (record for record in caplog.records if record.levelname == "DEBUG")
        lines = [record.getMessage().replace(line.path, "PORT") for record in debug]
        return [text for text in lines if words in text]

    with terminal() as line:
        async with rtu_units(line, {units: NumberingUnit(fault)}, echo=echo):
            table = f'kind = "modbus-rtu"\nport = "{line.path}"\ntimeout_ms = 50\nunit = 1'
            source = source_in({}, table, ["register = 0", "register = 1"], 50.0)
            reading = asyncio.create_task(take_across_sessions(source, 10_000))
            try:
                await until(lambda: len(found()) >= number)
            finally:
                reading.cancel()
                await asyncio.wait([reading])
    return found()


async def test_each_request_and_answer_of_a_bus_is_logged_in_hexadecimal(caplog: pytest.LogCaptureFixture) -> None:
    asked = f"PORT: unit 1 asked for registers 0 to 1 by function 4 ({REQUEST.hex(' ')}); answered after "
    answered = await lines_with(asked, no_fault, caplog, number=10)
    assert all(line.startswith(asked) and "(01 04 04 00 " in line for line in answered)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (
            lambda _number, _frame: [],
            "ms: not a byte came; no intact frame has come since the port was opened; silence has many reasons: with "
            "the daemon stopped, `beamtouch-daemon scan PORT` finds baud, parity and number; if it finds no unit, "
            "exchange A and B, then check the supply",
        ),
        (lambda number, frame: [(0.0, frame)] if number < 9 else [], "not a byte came; the last intact frame came 0."),
        (lambda number, frame: [(0.0, frame)] if number < 9 else [], "unit 1 has answered before: check its supply"),
        (
            lambda _number, _frame: [(0.0, b"\0"), (0.01, b"\0\xff")],
            "only 00 and ff, so the line has no level between frames: exchange A and B",
        ),
        (
            lambda _number, frame: [(0.0, b"\xff" + frame)],
            "1 byte came before it (ff): stray bytes, harmless while answers come",
        ),
        (
            lambda _number, frame: [(0.0, frame + b"\xfe")],
            "1 byte came after it (fe): stray bytes, harmless while answers come",
        ),
        (
            lambda _number, frame: [(0.0, frame + frame)],
            "a second answer of unit 1 to one request, equal to the first: an adapter that repeats, or two units",
        ),
        (
            lambda _number, frame: [(0.0, frame), (0.01, frame)],
            "a second answer of unit 1 to one request, equal to the first: an adapter that repeats, or two units",
        ),
        (
            lambda _number, frame: [(0.0, frame), (0.01, with_crc(frame[:-3] + b"\xf0"))],
            "a second answer of unit 1 to one request, unlike the first: two units have the number 1",
        ),
        (lambda _number, frame: [(0.08, frame)], "the late answer of unit 1 to the request before, read "),
        (lambda _number, frame: [(0.0, frame[:-3])], "which breaks off after 6 of 9 bytes"),
        (lambda _number, frame: [(0.0, frame[:-1] + bytes([frame[-1] ^ 1]))], "and none was intact: probably two"),
        (
            lambda number, frame: [(0.0, frame if number % 9 else frame[:-1] + bytes([frame[-1] ^ 1]))],
            "an answer of unit 1 with a wrong checksum, where others were intact: a bad line (wiring, ",
        ),
        (lambda _number, frame: [(0.0, with_crc(b"\5" + frame[1:-2]))], "an intact answer of unit 5"),
        (lambda _number, _frame: [(0.0, bytes([0x00, 0xF8, 0x80, 0x00, 0x78]))], "no Modbus frame: another baud rate"),
        (lambda _number, _frame: [(0.0, b"login: raspberry")], "text: 'login: raspberry'"),
    ],
    ids=[
        "silent",
        "gone",
        "answered before",
        "A and B swapped",
        "noise before",
        "noise after",
        "two units at once",
        "an answer twice",
        "two units one after the other",
        "late",
        "cut off",
        "damaged",
        "damaged now and then",
        "another unit",
        "another baud rate",
        "a console",
    ],
)
async def test_a_bad_line_is_named_by_what_came_instead(
    fault: Fault, words: str, caplog: pytest.LogCaptureFixture
) -> None:
    assert await lines_with(words, fault, caplog)


async def test_an_echo_without_an_answer_is_told_from_an_answer(caplog: pytest.LogCaptureFixture) -> None:
    words = "the request itself, which an adapter echoes, and nothing else; no intact frame"
    lines = await lines_with(words, no_fault, caplog, units=2, echo=lambda request: [(0.0, request)])
    assert "; silence has many reasons: with the daemon stopped, `beamtouch-daemon scan" in lines[0]


async def test_a_unit_whose_answers_come_late_is_said_to_be_late_without_the_debug_log() -> None:
    with terminal() as line:
        async with rtu_units(line, {1: NumberingUnit(lambda _number, frame: [(0.08, frame)])}):
            table = f'kind = "modbus-rtu"\nport = "{line.path}"\ntimeout_ms = 50\nunit = 1'
            source = source_in({}, table, ["register = 0"], 50.0)
            said = set[str]()
            with source.kept_open():
                async with asyncio.timeout(60):
                    while "unit 1 answers, but not within 50 ms: its answers come late" not in said:
                        with pytest.raises(SourceError) as error:
                            await first_readings(source, 1)
                        said.add(error.value.reason)


async def test_a_unit_that_was_late_and_then_sends_nothing_is_silent_and_no_longer_late(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rtu_line, "LATE_S", 0.5)
    with terminal() as line:
        units = {1: NumberingUnit(lambda number, frame: [(0.08, frame)] if number < 5 else []), 2: NumberingUnit()}
        async with rtu_units(line, units):
            table = f'kind = "modbus-rtu"\nport = "{line.path}"\ntimeout_ms = 50\nunit = 1'
            source = source_in({}, table, ["register = 0"], 50.0)
            said = list[str]()
            with source.kept_open():
                async with asyncio.timeout(60):
                    while not (said and said[-1].endswith("unit 1 does not answer within 50 ms")):
                        with pytest.raises(SourceError) as error:
                            await first_readings(source, 1)
                        said.append(error.value.reason)
    assert [reason for reason in said if reason.endswith("its answers come late")]


async def test_an_echo_before_each_answer_is_named(caplog: pytest.LogCaptureFixture) -> None:
    lines = await lines_with("; the adapter echoes requests", no_fault, caplog, echo=lambda request: [(0.0, request)])
    assert all(line.endswith("; the adapter echoes requests") for line in lines)


async def test_a_unit_that_is_silent_beside_one_that_answers_has_another_number_or_no_supply(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG, SOURCES)
    with terminal() as line:
        async with rtu_units(line, {2: NumberingUnit()}):
            table = f'kind = "modbus-rtu"\nport = "{line.path}"\ntimeout_ms = 50\nunit = 1'
            source = source_in({}, table, ["register = 0", "register = 0\nunit = 2"], 50.0)
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(1.0):
                    await take_across_sessions(source, 1_000)
    words = "other units answer, so the line works: check the number of unit 1, its supply and its cable"
    assert [record for record in caplog.records if record.getMessage().endswith(words)]


async def test_a_refusal_is_logged_with_its_meaning(caplog: pytest.LogCaptureFixture) -> None:
    refused = with_crc(bytes([1, 0x84, 2]))
    words = f"({refused.hex(' ')}); exception 2, it has no such register"
    assert await lines_with(words, lambda _number, _frame: [(0.0, refused)], caplog)


async def test_nothing_of_a_line_is_logged_unless_it_is_asked_for(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with terminal() as line:
        async with rtu_units(line, {1: NumberingUnit()}):
            table = f'kind = "modbus-rtu"\nport = "{line.path}"\ntimeout_ms = 50\nunit = 1'
            await take_across_sessions(source_in({}, table, ["register = 0"], 50.0), 5)
    assert [record for record in caplog.records if record.levelname == "DEBUG"] == []


@pytest.mark.parametrize(
    ("came", "words"),
    [
        (b"", "not a byte came"),
        (ANSWER, "an intact answer of unit 1, to an earlier request, to another master, or of another length"),
        (ANSWER + with_crc(bytes([5, 4, 2, 0, 7])), "an intact answer of units 1 and 5, to an earlier request"),
        (encode(5, TWO), "a request of another master to unit 5"),
        (b"\0" + encode(1, Block(7, 1)), "a request of another master to unit 1"),
        (with_crc(bytes([1, 6, 0, 1, 0, 3])), "an intact frame with function 6, of unit 1 or to it"),
        (REQUEST[:4], "a part of the request itself, which an adapter echoes"),
        (b"\0" + ANSWER[:6], "the beginning of an answer of unit 1, which breaks off after 6 of 9 bytes"),
        (b"\1", "1 byte came (01): too few bytes to tell"),
        (b"\0\xff", "2 bytes came (00 ff): too few bytes to tell"),
        (b"\0", "1 byte came (00): only 00 and ff, so the line has no level"),
        (ANSWER[:2], "2 bytes came (01 04): too few bytes to tell"),
        (b"\xff" + ANSWER[:2], "the beginning of an answer of unit 1, which breaks off after 2 of 5 bytes"),
        (ANSWER[:3], "the beginning of an answer of unit 1, which breaks off after 3 of 9 bytes"),
        (ANSWER[:8], "the beginning of an answer of unit 1, which breaks off after 8 of 9 bytes"),
        (bytes([1, 0x84, 2, 0]), "the beginning of an answer of unit 1, which breaks off after 4 of 5 bytes"),
        (bytes([1, 0x84, 2, 0, 0]), "an answer of unit 1 with a wrong checksum, and none was intact"),
        (bytes([2, 4, 4, 0]), "no Modbus frame: another baud rate or parity"),
        (REQUEST + ANSWER[:8], "the request itself, which an adapter echoes, then the beginning of an answer"),
    ],
)
def test_bytes_that_are_no_answer_are_named(came: bytes, words: str) -> None:
    assert words in describe_received(came, REQUEST, 1)


def test_an_answer_that_is_damaged_beside_intact_ones_is_the_fault_of_the_line() -> None:
    words = describe_received(bytes([1, 0x84, 2, 0, 0]), REQUEST, 1, has_answered=True)
    assert "an answer of unit 1 with a wrong checksum, where others were intact: a bad line" in words


TRAFFIC = bytes.fromhex("290808b1 290808b2 290808")


@pytest.mark.parametrize(
    ("came", "request_sent", "words"),
    [
        (TRAFFIC, b"", "another master is on the line, at another baud rate or parity"),
        (TRAFFIC[:-1], b"", "no Modbus frame: another baud rate"),
        (TRAFFIC, REQUEST, "no Modbus frame: another baud rate"),
    ],
    ids=["three times", "twice", "after a request"],
)
def test_bytes_that_repeat_though_nothing_was_asked_are_of_another_master(
    came: bytes, request_sent: bytes, words: str
) -> None:
    assert words in describe_received(came, request_sent, 1 if request_sent else None)


def test_bytes_before_any_request_may_be_of_any_unit() -> None:
    assert "the beginning of an answer of unit 2" in describe_received(bytes([2, 4, 4, 0]))


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (Block(7, 1, 3), "unit 5 asked for register 7 by function 3 (01)"),
        (Block(7, 2, 4), "unit 5 asked for registers 7 to 8 by function 4 (01)"),
        (Block(0, 9, 1), "unit 5 asked for coils 0 to 8 by function 1 (01)"),
        (Block(0, 1, 2), "unit 5 asked for discrete input 0 by function 2 (01)"),
    ],
)
def test_a_request_says_what_it_asks_for(block: Block, words: str) -> None:
    assert describe_request(5, block, b"\1") == words


def test_a_long_frame_is_shown_to_its_64th_byte() -> None:
    assert in_hex(bytes(64)) == " ".join(["00"] * 64)
    assert in_hex(bytes(65)) == f"{in_hex(bytes(64))} and 1 bytes more"


async def test_each_batch_is_logged_with_its_outcome(tmp_path: Path) -> None:
    async with serving(Service()) as service, pymodbus_server([21_000, 20_000]) as device:
        service.statuses = [503, 200]
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), url=service.url)
        async with started("run", config, "--log-level", "delivery=debug") as daemon:
            await service.until(20)
            outcome = await daemon.stop()
    lines = [line.partition(" DEBUG ")[2] for line in outcome.err.splitlines()]
    boot = service.batches[0][1].boot_id
    assert [line for line in lines if line.startswith(f"bench: live batch of boot {boot}, samples 1 to ")]
    assert [line for line in lines if line.endswith(": later: status 503")]
    assert [line for line in lines if ": taken: accepted=" in line and " expected=" in line]


def test_levels_can_be_set_for_the_parts_that_write_lines() -> None:
    folders = [folder.name for folder in pkgutil.iter_modules(beamtouch_daemon.__path__) if folder.ispkg]
    writing = {
        folder
        for folder in folders
        for module in pkgutil.iter_modules(import_module(f"beamtouch_daemon.{folder}").__path__)
        if hasattr(import_module(f"beamtouch_daemon.{folder}.{module.name}"), "_logger")
    }
    assert writing == set(cli.LOGGED)


@pytest.mark.parametrize(
    ("level", "words"),
    [
        ("loud", "'loud' must end with one of debug, info, warning, error"),
        ("wires=debug", "'wires=debug' must begin with one of delivery, "),
        ("sources=", "'sources=' must end with one of debug, info, warning, error"),
    ],
)
def test_a_wrong_level_is_refused_with_what_there_is(
    level: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(["check", "daemon.toml", "--log-level", level])
    assert stop.value.code == 2
    assert words in capsys.readouterr().err
