"""`check`, `tare` and wrong input, from the command line, with their exit codes."""

import asyncio
import json
import signal
import socket
from importlib.metadata import version
from pathlib import Path
from random import Random

import pytest

from . import configs
from .devices import Pieces, SerialDevice, StampingUnit, pymodbus_server, rtu_units
from .lines import terminal
from .process import Outcome, command, started

pytestmark = pytest.mark.anyio

EXTRA = ["pymodbus", "serial", "aiohttp", "numpy", "cobs"]


async def commands(*calls: tuple[str, Path]) -> list[Outcome]:
    """Run commands at the same time."""
    return await asyncio.gather(*(command(*call) for call in calls))


async def test_check_prints_every_channel_and_succeeds_when_all_are_good(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000]) as port:
        outcome = await command("check", configs.write(tmp_path, configs.surface(source=configs.tcp(port))))
    assert (outcome.code, outcome.err) == (0, "")
    *table, last = outcome.out.splitlines()
    assert [line.split() for line in table] == [
        ["surface", "channel", "counts", "gap", "mm", "deflection", "mm", "quality"],
        ["bench", "s1", "20000", "2.5000", "0.0000", "good"],
        ["bench", "s2", "21000", "2.4000", "0.1000", "good"],
    ]
    assert last == "The service was not asked whether it takes these samples; check --wait 5 asks it."


async def test_check_fails_when_a_channel_is_not_good_or_a_surface_cannot_be_read(tmp_path: Path) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        refusing = configs.tcp(unused.getsockname()[1])
        async with pymodbus_server([65_535, 21_000]) as port:
            bench = configs.surface(source=configs.tcp(port), registers=(0, 1, 40))
            config = configs.write(tmp_path, bench, configs.surface("press-7", refusing))
            outcome = await command("check", config, "--json")
    assert outcome.code == 1
    report = json.loads(outcome.out)
    assert report["good"] is False
    assert [channel["quality"] for channel in report["surfaces"]["bench"]["channels"]] == [
        "saturated",
        "good",
        "missing",
    ]
    assert report["surfaces"]["bench"]["channels"][2]["gap_mm"] is None
    assert report["surfaces"]["bench"]["channels"][1] == {
        "channel": "s2",
        "counts": 21_000,
        "gap_mm": pytest.approx(2.4),
        "deflection_mm": pytest.approx(0.1),
        "quality": "good",
    }
    assert report["surfaces"]["press-7"]["channels"] == []
    named, saturated, missing, refused = outcome.err.splitlines()
    assert saturated.startswith("beamtouch-daemon: bench: s1 saturated: the counts stand at an end of the ADC; check ")
    assert missing.startswith("beamtouch-daemon: bench: s3 missing: the device sent no value; check unit and register")
    assert "bench: unit 1 answers with exception 2: it has no such register: asked for 40; addresses count" in named
    assert refused.startswith("beamtouch-daemon: press-7: no connection to 127.0.0.1:")


async def test_check_reads_serial_lines(tmp_path: Path) -> None:
    with terminal() as bus, terminal() as line:
        SerialDevice(line)
        async with rtu_units(bus, {1: StampingUnit()}):
            config = configs.write(
                tmp_path,
                configs.surface("a", f"{configs.rtu(bus.path)}\ntimeout_ms = 5000"),
                configs.surface("b", configs.serial(line.path)),
            )
            outcome = await command("check", config, "--json")
            table = await command("check", config)
    surfaces = json.loads(outcome.out)["surfaces"]
    assert (surfaces["a"]["error"], surfaces["b"]["error"]) == (None, None)
    assert all(f"a: {limit}" in table.out for limit in surfaces["a"]["limits"])
    assert surfaces["a"]["limits"]
    assert [channel["counts"] for channel in surfaces["b"]["channels"]] == [20_000, 21_000]


async def test_check_reads_two_surfaces_that_share_a_bus(tmp_path: Path) -> None:
    with terminal() as bus:
        async with rtu_units(bus, {1: StampingUnit(), 2: StampingUnit()}):
            one, two = (f"{configs.rtu(bus.path)}\nunit = {unit}\ntimeout_ms = 5000" for unit in (1, 2))
            config = configs.write(tmp_path, configs.surface("a", one), configs.surface("b", two))
            outcome = await command("check", config, "--json")
            table = await command("check", config)
    surfaces = json.loads(outcome.out)["surfaces"]
    assert (surfaces["a"]["error"], surfaces["b"]["error"]) == (None, None)
    assert all(f"a: {limit}" in table.out for limit in surfaces["a"]["limits"])
    assert surfaces["a"]["limits"]


async def test_tare_writes_the_rest_gaps_and_check_uses_them(tmp_path: Path) -> None:
    async with pymodbus_server([20_500, 21_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        tared = await command("tare", config)
        checked = await command("check", config, "--json")
    assert (tared.code, tared.err) == (0, "")
    assert tared.out.startswith("bench: rest gaps s1 2.4500 mm, s2 2.4000 mm, mean of 200 readings, in ")
    content = json.loads((tmp_path / "bench.tare.json").read_text())
    assert content["rest_gap_mm"] == pytest.approx({"s1": 2.45, "s2": 2.4})
    channels = json.loads(checked.out)["surfaces"]["bench"]["channels"]
    assert [channel["deflection_mm"] for channel in channels] == pytest.approx([0, 0])


async def test_tare_replaces_a_file_that_cannot_be_used_and_says_what_it_cannot_write(tmp_path: Path) -> None:
    path = tmp_path / "bench.tare.json"
    async with pymodbus_server([20_500, 21_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        path.write_text("{}")
        replaced = await command("tare", config)
        content = json.loads(path.read_text())
        path.unlink()
        path.mkdir()
        refused = await command("tare", config)
    assert (replaced.code, sorted(content["rest_gap_mm"])) == (0, ["s1", "s2"])
    assert (refused.code, refused.complaint()) == (1, f"bench: cannot write {path}: Is a directory")


async def test_tare_refuses_rest_gaps_that_contradict_the_configuration_or_the_last_tare(tmp_path: Path) -> None:
    async def tare(registers: list[int], *options: str) -> Outcome:
        async with pymodbus_server(registers) as port:
            return await command("tare", configs.write(tmp_path, configs.surface(source=configs.tcp(port))), *options)

    loaded, first, drifted, light, accepted, again = [
        await tare([30_000, 20_000]),  # s1 is 1 mm down, as under a load
        await tare([20_500, 21_000]),  # mounted 0.05 and 0.1 mm closer than stated
        await tare([20_700, 20_900]),  # 0.02 mm of drift
        await tare([20_700, 22_900]),  # a light load, or one more
        await tare([20_700, 22_900], "--accept-change"),
        await tare([20_700, 22_900]),
    ]
    assert loaded.code == 1
    assert loaded.complaint() == (
        "bench: not tared: s1 -1.000 mm from its rest_gap_mm; take everything off the beam and tare again, "
        "or add --accept-change if nothing touches it: before the first tare, a load and a sensor mounted elsewhere "
        "look alike"
    )
    assert [outcome.code for outcome in (first, drifted, accepted, again)] == [0, 0, 0, 0]
    assert light.code == 1
    assert light.complaint().startswith("bench: not tared: s2 -0.200 mm from the last tare; take everything off")
    content = json.loads((tmp_path / "bench.tare.json").read_text())
    assert content["rest_gap_mm"] == pytest.approx({"s1": 2.43, "s2": 2.21})


async def test_tare_takes_a_channel_whose_last_tare_was_accepted_beyond_the_configuration(tmp_path: Path) -> None:
    async with pymodbus_server([30_000, 20_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        codes = [(await command("tare", config, *options)).code for options in ((), ("--accept-change",), ())]
    assert codes == [1, 0, 0]


async def test_tare_refuses_a_channel_whose_counts_stand_still(tmp_path: Path) -> None:
    chance = Random(3)  # noqa: S311 - noise, not secrets

    async def noise(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[1] = 20_000 + chance.randrange(-30, 31)

    async with pymodbus_server([20_000, 20_000], noise) as port:
        surface = configs.surface(source=configs.tcp(port)).replace("rate_hz", "noise_mm = 0.002\nrate_hz", 1)
        outcome = await command("tare", configs.write(tmp_path, surface))
    assert outcome.code == 1
    assert outcome.complaint() == "bench: not tared: s1 is stuck: its counts do not change; check the sensor"


async def test_tare_refuses_a_surface_that_moves_and_writes_nothing_for_it(tmp_path: Path) -> None:
    async def move(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[0] += 5  # s1 creeps

    async with pymodbus_server([20_000, 20_000], move) as port, pymodbus_server([20_000, 20_000]) as other:
        surfaces = (configs.surface("moving", configs.tcp(port)), configs.surface("still", configs.tcp(other)))
        outcome = await command("tare", configs.write(tmp_path, *surfaces))
    assert outcome.code == 1
    assert outcome.complaint().startswith("moving: not tared: s1 moved: standard deviation ")
    assert (tmp_path / "still.tare.json").exists()
    assert not (tmp_path / "moving.tare.json").exists()


async def test_a_port_that_does_not_exist_fails_its_own_surface_only(tmp_path: Path) -> None:
    async with pymodbus_server([21_000, 65_535]) as device:
        absent = configs.surface("late", source=configs.serial("/dev/ttyNO"))
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), absent)
        check, tare = await commands(("check", config), ("tare", config))
    words = "/dev/ttyNO cannot be opened (No such file or directory); plug the device in or correct the path"
    assert (check.code, tare.code) == (1, 1)
    assert words in check.out + check.err
    assert "s1" in check.out
    assert f"late: not tared: {words}" in tare.err


async def test_an_unknown_key_is_wrong_input(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface().replace("window", "windw"))
    outcome = await command("check", config)
    assert outcome.code == 2
    assert outcome.complaint().endswith("unknown key surfaces.bench.filter.windw; did you mean window?")


async def test_a_missing_token_file_is_named(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface())
    (tmp_path / "beamtouch.token").unlink()
    outcome = await command("run", config)
    assert outcome.code == 1  # it may come later, and systemd starts the daemon again
    assert outcome.complaint() == (
        f"token file {tmp_path / 'beamtouch.token'}: No such file or directory; "
        "publish.token_file must name a file with the service's token"
    )


async def test_a_surface_that_does_not_exist_is_wrong_input(tmp_path: Path) -> None:
    outcome = await command("tare", configs.write(tmp_path, configs.surface()), "--surface", "press")
    assert outcome.code == 2
    assert outcome.complaint() == "--surface: there is no surface press; choose one of bench"


async def test_a_tare_file_that_does_not_fit_is_wrong_input(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface())
    (tmp_path / "bench.tare.json").write_text("{}")
    outcome = await command("run", config)
    assert outcome.code == 2
    assert outcome.complaint().endswith("not a tare file; delete it or run beamtouch-daemon tare again")


async def test_a_summary_that_could_not_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface())
    outcome = await command("run", config, "--summary", tmp_path / "absent" / "summary.json")
    assert outcome.code == 2
    assert outcome.complaint().endswith("absent: no such folder; create it first")


async def test_a_missing_extra_is_named_with_what_to_install(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface())

    blocks = [f"import sys; sys.modules['{module}'] = None" for module in EXTRA]
    for outcome in await asyncio.gather(*(command("run", config, code=block) for block in blocks)):
        assert outcome.code == 2
        assert outcome.complaint().endswith(" is not installed; run: pip install 'beamtouch[daemon]'")


async def test_help_needs_no_extra() -> None:
    outcome = await command("--help", code=f"import sys; sys.modules.update(dict.fromkeys({EXTRA}))")
    assert (outcome.code, outcome.err) == (0, "")
    assert all(name in outcome.out for name in ("run", "check", "tare", "noise"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), ": the following arguments are required: COMMAND; see beamtouch-daemon --help"),
        (("run",), " run: the following arguments are required: CONFIG; see beamtouch-daemon run --help"),
        (("tare", "daemon.toml", "--new"), " tare: unknown argument --new; see beamtouch-daemon tare --help"),
        (
            ("record", "daemon.toml", "-o", "x.csv", "--seconds", "a"),
            " record: argument --seconds: not a number: 'a'; see beamtouch-daemon record --help",
        ),
    ],
)
async def test_wrong_arguments_are_one_line_and_exit_2(arguments: tuple[str, ...], said: str) -> None:
    outcome = await command(*arguments)
    assert (outcome.code, outcome.out, outcome.err) == (2, "", f"beamtouch-daemon{said}\n")


async def test_the_version_is_that_of_the_distribution() -> None:
    outcome = await command("--version")
    assert (outcome.code, outcome.out, outcome.err) == (0, f"beamtouch-daemon {version('beamtouch')}\n", "")


@pytest.mark.parametrize("name", ["check", "tare", "record", "noise"])
async def test_ctrl_c_ends_a_command_with_130_and_no_traceback(tmp_path: Path, name: str) -> None:
    asked = asyncio.Event()

    def silent(_number: int, _frame: bytes) -> Pieces:
        asked.set()
        return []

    with terminal() as bus:
        async with rtu_units(bus, {1: StampingUnit(silent)}):
            config = configs.write(tmp_path, configs.surface(source=f"{configs.rtu(bus.path)}\ntimeout_ms = 20000"))
            options = ("-o", tmp_path / "loads.csv") if name == "record" else ()
            async with started(name, config, *options) as daemon:
                if name == "record":
                    daemon.answer("100 5")
                await asked.wait()
                outcome = await daemon.stop(signal.SIGINT)
    assert outcome.code == 130
    assert "Traceback" not in outcome.err
