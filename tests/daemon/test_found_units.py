"""What a scan prints of units and boards that answered, and of bytes that are no answer."""

import json

import pytest

from beamtouch_daemon.commands.scan_report import Findings, FoundUnit, Source
from beamtouch_daemon.sources.traffic import Traffic
from beamtouch_protocol.messages import PROTOCOL_VERSION, SCHEMA_HASH, Hello

BUS: Source = {"kind": "modbus-rtu", "port": "/dev/ttyUSB0", "baud": 19_200, "parity": "even", "timeout_ms": 150}
NETWORK: Source = {"kind": "modbus-tcp", "host": "plc", "port": 1502, "unit": 7, "function": 4, "timeout_ms": 200}
BOARD: Source = {"kind": "serial", "port": "/dev/ttyACM0", "baud": 1_000_000}
HELLO = Hello(PROTOCOL_VERSION, SCHEMA_HASH, 77, 3, 12, 2000)


def printed(findings: Findings, capsys: pytest.CaptureFixture[str], *, as_json: bool = False) -> str:
    findings.print(as_json=as_json)
    return capsys.readouterr().out


@pytest.mark.parametrize(
    ("unit", "registers"),
    [
        (FoundUnit(BUS, (4, 3)), "input, holding"),
        (FoundUnit(BUS, (3,)), "holding"),
        (FoundUnit(BUS, ()), "none: see its manual"),
        (FoundUnit(BUS, (4,), (6,)), "input; refuses some requests: exception 6, device busy"),
    ],
)
def test_a_unit_is_shown_with_the_registers_that_it_has(unit: FoundUnit, registers: str) -> None:
    assert unit.registers == registers


def test_units_are_a_table_with_the_command_that_configures_the_first(capsys: pytest.CaptureFixture[str]) -> None:
    found = [FoundUnit(BUS | {"unit": 3, "function": 3}, (3,)), FoundUnit(BUS | {"unit": 12, "function": 4}, (4, 3))]
    findings = Findings("/dev/ttyUSB0", found)
    head, *rows, empty, command = printed(findings, capsys).splitlines()
    assert head.split() == ["unit", "baud", "parity", "registers", "from", "0"]
    assert [row.split() for row in rows] == [
        ["3", "19200", "even", "holding"],
        ["12", "19200", "even", "input,", "holding"],
    ]
    assert (empty, command) == (
        "",
        "beamtouch-daemon init daemon.toml --model-config FILE --source rtu:/dev/ttyUSB0 --baud 19200 --parity even "
        "--unit 3 --function 3 --timeout-ms 150",
    )
    assert findings.has_any


@pytest.mark.parametrize(("host", "where"), [("plc", "tcp://plc:1502"), ("::1", "'tcp://[::1]:1502'")])
def test_a_unit_behind_an_address_has_no_line(host: str, where: str, capsys: pytest.CaptureFixture[str]) -> None:
    findings = Findings("tcp://plc", [FoundUnit(NETWORK | {"host": host}, (4,))])
    _, row, _, command = printed(findings, capsys).splitlines()
    assert row.split() == ["7", "-", "-", "input"]
    assert command.endswith(f" --source {where} --unit 7 --function 4 --timeout-ms 200")


@pytest.mark.parametrize(
    ("hello", "said"),
    [
        (HELLO, "3 channels, 12 ADC bits, at most 2000 readings per second"),
        (
            Hello(9, 5, 77, 3, 12, 2000),
            "it speaks protocol 9, another than this daemon; update the older of the two",
        ),
    ],
)
def test_a_board_is_described_with_the_command_that_configures_it(
    hello: Hello, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    findings = Findings("/dev/ttyACM0", board=(BOARD, hello))
    assert findings.has_any
    assert printed(findings, capsys) == (
        f"a Beamtouch board at 1000000 baud: {said}\n\nbeamtouch-daemon init daemon.toml --model-config FILE --source "
        "serial:/dev/ttyACM0 --baud 1000000\n"
    )


def test_the_json_has_the_target_the_units_and_the_board(capsys: pytest.CaptureFixture[str]) -> None:
    findings = Findings("/dev/x", [FoundUnit(NETWORK, (4, 3)), FoundUnit(BUS, (3,), (6, 11))], (BOARD, HELLO))
    found = json.loads(printed(findings, capsys, as_json=True))
    assert (found["target"], found["board"]["source"], found["board"]["adc_bits"]) == ("/dev/x", BOARD, 12)
    assert found["units"] == [
        {"source": NETWORK, "registers": ["input", "holding"]},
        {"source": BUS, "registers": ["holding"], "refusals": [6, 11]},
    ]
    assert json.loads(printed(Findings("/dev/x"), capsys, as_json=True)) == {
        "target": "/dev/x",
        "units": [],
        "board": None,
    }
    assert not Findings("/dev/x").has_any


def test_bytes_that_are_no_answer_are_named_with_the_settings_of_the_line() -> None:
    findings = Findings("/dev/x")
    assert findings.failure("try again") == ""
    for name, data in (("9600 baud", b"\0\1\2"), ("19200 baud", b""), ("38400 baud", b"\0\1\2\3")):
        traffic = Traffic(0.0)
        traffic.note_other(data)
        findings.note(name, traffic)
    assert findings.failure("try again") == (
        "nothing answers, but bytes came that are no answer: 3 bytes at 9600 baud, 4 bytes at 38400 baud; stop other "
        "masters, or try again"
    )
    for name, data in (("57600 baud", b"boot one"), ("115200 baud", b"boot two")):
        traffic = Traffic(0.0)
        traffic.note_other(data)
        findings.note(name, traffic)
    assert findings.failure("try again") == (
        "nothing answers, but at 115200 baud, the device prints text: 'boot two'; is it the right device, and does it "
        "start again and again?"
    )
