"""The command line on which loads stand as words: `--at MM N`, and three numbers on a plate."""

import pytest

from beamtouch_daemon.cli import _join_loads, _parser


@pytest.mark.parametrize(
    ("words", "joined"),
    [
        ("record c.toml --at 150 10", ["record", "c.toml", "--at", "150 10"]),
        ("record --at 150 10 c.toml", ["record", "--at", "150 10", "c.toml"]),
        ("record --at 150 80 10 c.toml", ["record", "--at", "150 80 10", "c.toml"]),
        ("--at 1,5 2 --at -3 4 5 -o x", ["--at", "1,5 2", "--at", "-3 4 5", "-o", "x"]),
        ("--at 150 -o x", ["--at", "150", "-o", "x"]),
        ("--at ten five c.toml", ["--at", "ten five", "c.toml"]),  # what is no load is said later
        ("--at", ["--at"]),
        ("--at -o x", ["--at", "-o", "x"]),
        ("--at 150", ["--at", "150"]),
        ("--at 150 80 x", ["--at", "150 80", "x"]),
        ("--at 150 80 7", ["--at", "150 80 7"]),
        ("check c.toml", ["check", "c.toml"]),
    ],
)
def test_the_numbers_of_a_load_are_one_word(words: str, joined: list[str]) -> None:
    assert _join_loads(words.split()) == joined


def parsed(words: str) -> dict[str, object]:
    return vars(_parser().parse_args(_join_loads(words.split())))


def test_loads_are_given_in_their_order_and_a_recording_takes_2_s() -> None:
    found = parsed("record --at 150 10 --at 1 2 3 c.toml -o x.csv")
    assert (found["at"], found["seconds"], found["accept"], found["append"]) == (
        [["150", "10"], ["1", "2", "3"]],
        2.0,
        False,
        False,
    )
    assert parsed("record c.toml -o x.csv --seconds 0.5 --accept --append")["seconds"] == 0.5


@pytest.mark.parametrize(
    ("words", "taken"),
    [
        ("run c.toml", {"log_format": "text", "log_level": [], "summary": None, "token_file": None}),
        ("run c.toml --log-format json", {"log_format": "json"}),
        ("check c.toml", {"json": False, "wait": None}),
        ("check c.toml --json --wait 86400", {"json": True, "wait": 86_400.0}),
        ("tare c.toml", {"accept_change": False, "surface": None}),
        ("tare c.toml --accept-change --surface b", {"accept_change": True, "surface": "b"}),
        ("noise c.toml", {"json": False, "seconds": None}),
        ("noise c.toml --json --seconds 7", {"json": True, "seconds": 7.0}),
        ("scan x", {"json": False, "timeout_ms": None, "baud": None, "parity": None, "units": None}),
        ("scan x --json --timeout-ms 60000", {"json": True, "timeout_ms": 60_000.0}),
        ("scan x --timeout-ms 1", {"timeout_ms": 1.0}),
        ("init c.toml", {"force": False, "register": None, "unit": None, "function": None}),
        (
            "init c.toml --force --register 65535 --unit 255 --function 3",
            {"register": 65_535, "unit": 255, "function": 3},
        ),
        ("init c.toml --register 0 --unit 0 --function 4 --baud 300", {"register": 0, "unit": 0, "baud": 300}),
        ("init c.toml --baud 12000000 --timeout-ms 1", {"baud": 12_000_000, "timeout_ms": 1.0}),
    ],
)
def test_options_have_their_values_and_defaults(words: str, taken: dict[str, object]) -> None:
    assert parsed(words).items() >= taken.items()


@pytest.mark.parametrize(
    "words",
    [
        "check c.toml --wait 86401",
        "check c.toml --wait -1",
        "scan x --timeout-ms 60001",
        "scan x --timeout-ms 0.9",
        "init c.toml --register 65536",
        "init c.toml --register -1",
        "init c.toml --unit 256",
        "init c.toml --baud 299",
        "init c.toml --baud 12000001",
        "init c.toml --function 2",
        "init c.toml --timeout-ms 60001",
        "record c.toml",  # without its file
        "",
    ],
)
def test_an_option_outside_its_limits_is_refused(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        parsed(words)
    assert stop.value.code == 2
    assert capsys.readouterr().err
