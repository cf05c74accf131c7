"""The arguments of the commands of `design-sensors`: what each is by default, its bounds, and which exclude others."""

from pathlib import Path
from typing import Any

import pytest

from beamtouch_common.commands import Parser
from beamtouch_models.commands import arguments
from beamtouch_models.commands.build import how_to_try

SHARED = {"seed": 0, "effort": 1.0, "json": False}
SPREAD = {"workers": None, "cluster": None}
LAYOUT = {"sensors": None, "criterion": None, "failed_percent": None}
COMMANDS: dict[str, tuple[str, dict[str, Any]]] = {
    "build": (
        "a.toml -o b.onnx",
        {
            "scene": Path("a.toml"), "output": Path("b.onnx"), "loads": None, "move_sensors": False,
            "estimator": "posterior", "daemon_config": None, "report": None, "force": False,
        } | LAYOUT | SHARED,
    ),
    "calibrate": (
        "a.onnx b.csv -o c.onnx",
        {
            "model": Path("a.onnx"), "readings": Path("b.csv"), "events": None, "leave_out": [], "placing_mm": 1.0,
            "mounting_mm": 1.5, "force_percent": 1.0, "output": Path("c.onnx"), "effort": 1.0, "json": False,
        },
    ),
    "challenge": ("a.onnx", {"model": Path("a.onnx"), "draws": 400, "seed": 0, "json": False} | SPREAD),
    "evaluate": ("a.onnx", {"model": Path("a.onnx"), "noise": [], "draws": 16_384, "seed": 0, "json": False} | SPREAD),
    "explain": ("a.toml", {"scene": Path("a.toml"), "zones": None, "effort": 1.0, "json": False}),
    "inspect": ("a.onnx", {"model": Path("a.onnx"), "json": False}),
    "new": (
        "a.toml --length-mm 400 --width-mm 25 --thickness-mm 3",
        {
            "scene": Path("a.toml"), "length_mm": 400.0, "width_mm": 25.0, "thickness_mm": 3.0, "material": None,
            "left": None, "right": None, "roller_mm": None, "force_n": None, "position_mm": None, "sensors": None,
            "noise_mm": None, "rate_hz": None, "range_mm": None, "size_mm": None, "latency_ms": None,
            "position_error_mm": None, "force": False,
        },
    ),
    "place": ("a.toml", {"scene": Path("a.toml"), "components": None, "search": "exchange"} | LAYOUT | SHARED),
    "reproduce": ("-o out", {"output": Path("out"), "seed": 0, "json": False}),
    "scenes": ("", {"copy": None, "force": False, "json": False}),
    "schema": ("", {}),
    "trade": (
        "a.toml -o out",
        {
            "scene": Path("a.toml"), "output": Path("out"), "latency_ms": None, "error_mm": None, "estimators": None,
            "draws": 4096,
        } | SHARED | SPREAD,
    ),
}  # fmt: skip
"""The least that each command takes, and all its options then."""


def parsed(command: str, *words: str) -> dict[str, Any]:
    parser = Parser(command)
    getattr(arguments, command)(parser)
    return vars(parser.parse_args([*COMMANDS[command][0].split(), *words]))


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_with_the_least_has_its_defaults(command: str) -> None:
    assert parsed(command) == COMMANDS[command][1]


@pytest.mark.parametrize(
    ("command", "option", "least", "most"),
    [
        ("build", "--sensors", 1, 64),
        ("build", "--seed", 0, 4294967295),
        ("calibrate", "--leave-out", 0, 2147483647),
        ("challenge", "--draws", 10, 10_000),
        ("challenge", "--workers", 1, 1024),
        ("evaluate", "--draws", 100, 1_000_000),
        ("new", "--sensors", 1, 64),
        ("place", "--components", 1, 64),
        ("trade", "--draws", 100, 1_000_000),
    ],
)
def test_a_number_is_taken_from_its_least_to_its_most(
    command: str, option: str, least: int, most: int, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (least, most):
        given = parsed(command, option, str(number))[option.removeprefix("--").replace("-", "_")]
        assert given in (number, [number])
    for number in (least - 1, most + 1):
        with pytest.raises(SystemExit):
            parsed(command, option, str(number))
        assert f"'{number}' is not a whole number from {least} to {most}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "words", "said"),
    [
        ("build", "--loads b.csv", "not allowed with"),
        ("build", "--failed-percent 20 --spare 1", "not allowed with"),
        ("build", "--spare 2", "'2' is neither 0 nor 1"),
        ("build", "--estimator best", "invalid choice: 'best'"),
        ("build", "--criterion best", "invalid choice: 'best'"),
        ("calibrate", "--events b.csv", "not allowed with"),
        ("challenge", "--workers 2 --cluster tcp://a:1", "not allowed with"),
        ("trade", "--latency-ms 3 --error-mm 4", "not allowed with"),
        ("trade", "--estimators best", "invalid choice: 'best'"),
        ("place", "--search best", "invalid choice: 'best'"),
        ("new", "--left glued", "invalid choice: 'glued'"),
        ("new", "--right glued", "invalid choice: 'glued'"),
        ("new", "--material cheese", "invalid choice: 'cheese'"),
        ("new", "--force-n 3", "expected 2 arguments"),
        ("new", "--noise-mm 3 4", "unknown argument 4"),
    ],
)
def test_what_excludes_each_other_or_is_no_choice_is_refused(
    command: str, words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        parsed(command, *words.split())
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "words", "missing"),
    [
        ("build", ["a.toml"], "-o/--output"),
        ("build", ["-o", "b"], "SCENE --loads"),
        ("calibrate", ["a", "-o", "b"], "READINGS.csv --events"),
        ("calibrate", ["a", "b"], "-o/--output"),
        ("new", ["a", "--length-mm", "3", "--width-mm", "3"], "--thickness-mm"),
        ("new", ["a", "--length-mm", "3", "--thickness-mm", "3"], "--width-mm"),
        ("new", ["a", "--width-mm", "3", "--thickness-mm", "3"], "--length-mm"),
        ("trade", ["a.toml"], "-o/--output"),
    ],
)
def test_what_must_be_given_is_asked_for(
    command: str, words: list[str], missing: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parser = Parser(command)
    getattr(arguments, command)(parser)
    with pytest.raises(SystemExit):
        parser.parse_args(words)
    assert missing in capsys.readouterr().err


def test_options_that_are_repeated_or_take_several_values_keep_all() -> None:
    assert parsed("calibrate", "--leave-out", "3", "--leave-out", "5")["leave_out"] == [3, 5]
    assert parsed("evaluate", "--noise", "0.1", "--noise", "0.2")["noise"] == [0.1, 0.2]
    rollers, ends = ("--roller-mm", "100", "--roller-mm", "200"), ("--left", "clamped", "--right", "free")
    new = parsed("new", *rollers, *ends, "--force-n", "2", "20")
    assert (new["roller_mm"], new["force_n"], new["left"], new["right"]) == ([100, 200], [2, 20], "clamped", "free")
    assert parsed("trade", "--estimators", "posterior", "paper-network")["estimators"] == ["posterior", "paper-network"]
    assert parsed("scenes", "--copy", "bench", "here")["copy"] == ["bench", "here"]


@pytest.mark.parametrize("switch", ["--move-sensors", "--force", "--json"])
def test_a_switch_is_on_when_it_is_given(switch: str) -> None:
    assert parsed("build", switch)[switch.removeprefix("--").replace("-", "_")] is True


def test_spare_sensors_are_short_for_a_share_of_the_time() -> None:
    assert [parsed("place", "--spare", number)["failed_percent"] for number in "01"] == [0.0, 100.0]
    assert parsed("place", "--failed-percent", "20")["failed_percent"] == 20.0


@pytest.mark.parametrize("address", ["tcp://10.0.0.7:8786", "tls://host:1"])
def test_a_cluster_has_the_address_of_a_scheduler(address: str) -> None:
    assert parsed("challenge", "--cluster", address)["cluster"] == address


@pytest.mark.parametrize(
    "address", ["10.0.0.7:8786", "http://host:1", "tcp://host", "tcp://:1", "tcp://h:1/x", "tcp://h:x"]
)
def test_another_address_of_a_cluster_is_refused(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parsed("challenge", "--cluster", address)
    assert f"'{address}' is not tcp://HOST:PORT" in capsys.readouterr().err


def test_what_build_advises_to_try_are_three_commands_and_of_loads_the_daemon_that_recorded_them() -> None:
    files = "a.toml", "b.onnx", "token", "d.toml"
    assert how_to_try(*files, is_recorded=False).splitlines() == [
        "try it:  beamtouch-rig a.toml --model b.onnx --modbus-tcp 127.0.0.1:5020",
        "         beamtouch-service run --model b.onnx --write-token-file token",
        "         beamtouch-daemon run d.toml",
    ]
    assert how_to_try(*files, is_recorded=True).splitlines() == [
        "try it:  beamtouch-service run --model b.onnx --write-token-file token",
        "         copy beam, noise_mm, zero_drift_mm, filter, zero_tracking and loads of d.toml into the",
        "         configuration that recorded a.toml, then beamtouch-daemon run with it",
    ]
