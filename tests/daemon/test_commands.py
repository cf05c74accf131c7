"""`check`, `tare` and what all commands share: input that is refused, Ctrl-C, a library that is missing."""

import asyncio
import json
import signal
import socket
from pathlib import Path
from random import Random

import pytest

from support.surfaces import configs

from .conftest import Refused
from .devices import Pieces, SerialDevice, StampingUnit, pymodbus_server, rtu_units
from .lines import terminal
from .process import Outcome, command, started

pytestmark = pytest.mark.anyio

NOT_TARED = (
    "not tared: the rest gaps are those of the configuration; run beamtouch-daemon tare, with nothing on the beam"
)
READS = "the command reads this file as well; name another one"
EXTRA = ["pymodbus", "serial", "aiohttp", "numpy", "cobs"]


async def test_check_prints_every_channel_with_the_digits_of_its_sensor(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_001]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        outcome = await command("check", config)
        as_json = await command("check", config, "--json")
    assert (outcome.code, outcome.err) == (0, "")
    *table, untared, last = outcome.out.splitlines()
    assert [line.split() for line in table] == [
        ["surface", "channel", "counts", "gap", "mm", "deflection", "mm", "quality"],
        ["bench", "s1", "20000", "2.5000", "0.0000", "good"],
        ["bench", "s2", "21001", "2.3999", "0.1001", "good"],
    ]
    assert untared == f"bench: {NOT_TARED}"
    assert last == "The service was not asked whether it takes these samples; check --wait 5 asks it."
    assert '"counts": 21001, "gap_mm": 2.3999, "deflection_mm": 0.1001' in as_json.out
    bench = json.loads(as_json.out)["surfaces"]["bench"]
    assert (bench["service"], bench["tared"]) == (None, False)


@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "The exit code is 0 if every channel is good and the service takes samples.",
)
async def test_check_fails_when_a_channel_is_not_good_or_a_surface_cannot_be_read(tmp_path: Path) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        refusing = configs.tcp(unused.getsockname()[1])
        async with pymodbus_server([65_535, 21_000]) as port:
            bench = configs.surface(source=configs.tcp(port), registers=(0, 1, 40))
            late = configs.surface("late", configs.serial("/dev/ttyNO"))
            config = configs.write(tmp_path, bench, configs.surface("press-7", refusing), late)
            outcome, tared = await asyncio.gather(command("check", config, "--json"), command("tare", config))
    assert (outcome.code, tared.code) == (1, 1)
    report = json.loads(outcome.out)
    assert report["good"] is False
    qualities = [channel["quality"] for channel in report["surfaces"]["bench"]["channels"]]
    assert qualities == ["saturated", "good", "missing"]
    assert report["surfaces"]["bench"]["channels"][2]["gap_mm"] is None
    assert report["surfaces"]["press-7"]["channels"] == []
    absent = "/dev/ttyNO cannot be opened (No such file or directory); plug the device in or correct the path"
    for words, line in zip(
        (
            "bench: unit 1 answers with exception 2: it has no such register: asked for 40; addresses count from 0",
            "beamtouch-daemon: bench: s1 saturated: the counts stand at an end, or near 0 as without a cable; check ",
            "beamtouch-daemon: bench: s3 missing: the device sent no value, NaN or more than 1e12; check unit",
            "beamtouch-daemon: press-7: no connection to 127.0.0.1:",
            f"beamtouch-daemon: late: {absent}",
        ),
        outcome.err.splitlines(),
        strict=True,
    ):
        assert words in line
    assert "bench: not tared: s1 is saturated in 200 of 200 readings" in tared.err
    assert f"late: not tared: {absent}" in tared.err


async def test_check_reads_serial_lines_and_surfaces_that_share_a_bus(tmp_path: Path) -> None:
    with terminal() as bus, terminal() as line:
        SerialDevice(line)
        async with rtu_units(bus, {1: StampingUnit(), 2: StampingUnit()}):
            one, two = (f"{configs.rtu(bus.path)}\nunit = {unit}\ntimeout_ms = 5000" for unit in (1, 2))
            sources = {"a": one, "b": two, "c": configs.serial(line.path)}
            config = configs.write(tmp_path, *(configs.surface(*item) for item in sources.items()))
            outcome, table = await command("check", config, "--json"), await command("check", config)
    surfaces = json.loads(outcome.out)["surfaces"]
    assert [surface["error"] for surface in surfaces.values()] == [None] * 3
    assert all(f"a: {limit}" in table.out for limit in surfaces["a"]["limits"])
    assert [channel["counts"] for channel in surfaces["c"]["channels"]] == [20_000, 21_000]


async def test_tare_writes_the_rest_gaps_in_place_of_a_file_that_cannot_be_used(tmp_path: Path) -> None:
    path = tmp_path / "bench.tare.json"
    path.write_text("{}")
    async with pymodbus_server([20_500, 21_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        tared = await command("tare", config)
        checked = await command("check", config, "--json")
        rest_gap_mm = json.loads(path.read_text())["rest_gap_mm"]
        path.unlink()
        path.mkdir()
        refused = await command("tare", config)
    assert (tared.code, tared.err) == (0, "")
    assert tared.out.startswith("bench: rest gaps s1 2.4500 mm, s2 2.4000 mm, mean of 200 readings, in ")
    assert rest_gap_mm == pytest.approx({"s1": 2.45, "s2": 2.4})
    bench = json.loads(checked.out)["surfaces"]["bench"]
    assert [channel["deflection_mm"] for channel in bench["channels"]] == pytest.approx([0, 0])
    assert bench["tared"] is True
    assert (refused.code, refused.complaint()) == (1, f"bench: cannot write {path}: Is a directory")


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "one that differs from the last tare, or in the first tare from `rest_gap_mm`",
)
@pytest.mark.promise("docs/how-to/commissioning.md", "The first tare of a real beam is usually refused")
async def test_tare_refuses_rest_gaps_that_contradict_the_configuration_or_the_last_tare(tmp_path: Path) -> None:
    async def tare(registers: list[int], *options: str) -> Outcome:
        async with pymodbus_server(registers) as port:
            return await command("tare", configs.write(tmp_path, configs.surface(source=configs.tcp(port))), *options)

    loaded, accepted, drifted, light = [
        await tare([30_000, 20_000]),  # s1 is 1 mm down, as under a load
        await tare([30_000, 20_000], "--accept-change"),
        await tare([30_200, 19_900]),  # 0.02 mm of drift, still far from the configuration
        await tare([30_200, 21_900]),  # a light load
    ]
    assert [outcome.code for outcome in (loaded, accepted, drifted, light)] == [1, 0, 0, 1]
    assert loaded.complaint() == (
        "bench: not tared: s1 -1.000 mm from its rest_gap_mm; take everything off the beam and tare again, "
        "or add --accept-change if nothing touches it: before the first tare, a load and a sensor mounted elsewhere "
        "look alike"
    )
    assert light.complaint().startswith("bench: not tared: s2 -0.200 mm from the last tare; take everything off")
    content = json.loads((tmp_path / "bench.tare.json").read_text())
    assert content["rest_gap_mm"] == pytest.approx({"s1": 1.48, "s2": 2.51})


LIKE_WARMTH = (
    "; all have changed about alike, by {} mm, as in a hall that warms or cools, and unlike most loads: look that "
    "nothing touches the beam, wait until it no longer drifts, and add --accept-change; if the hall does so often, "
    "state how fast in zero_tracking.drift_um_per_min"
)
LIKE_A_LOAD = (
    "; take everything off the beam and tare again, or add --accept-change if the sensors were moved or the beam was "
    "changed"
)


@pytest.mark.promise(
    "docs/how-to/drift.md",
    "If the zeros have gone farther, `tare` refuses, with about the same distance for each sensor, and says that it "
    "looks like a hall that warms or cools.",
)
@pytest.mark.parametrize(
    ("registers", "moved", "said"),
    [
        ([21_000, 21_100, 20_900], "s1 -0.100 mm, s2 -0.110 mm, s3 -0.090 mm", LIKE_WARMTH.format("-0.100")),
        ([19_000, 19_000, 19_000], "s1 +0.100 mm, s2 +0.100 mm, s3 +0.100 mm", LIKE_WARMTH.format("+0.100")),
        ([21_000, 21_600, 21_000], "s1 -0.100 mm, s2 -0.160 mm, s3 -0.100 mm", LIKE_A_LOAD),
        ([21_000, 21_000, 19_000], "s1 -0.100 mm, s2 -0.100 mm, s3 +0.100 mm", LIKE_A_LOAD),
        ([21_000, 21_000], "s1 -0.100 mm, s2 -0.100 mm", LIKE_A_LOAD),
    ],
    ids=["warmer", "cooler", "a load", "not one way", "two sensors"],
)
async def test_tare_says_what_looks_like_warmth_and_what_does_not(
    tmp_path: Path, registers: list[int], moved: str, said: str
) -> None:
    async def tare(now: list[int]) -> Outcome:
        async with pymodbus_server(now) as port:
            surface = configs.surface(source=configs.tcp(port), registers=tuple(range(len(now))))
            return await command("tare", configs.write(tmp_path, surface))

    rested = await tare([20_000] * len(registers))
    refused = await tare(registers)
    assert (rested.code, refused.code) == (0, 1)
    expected = moved.replace(" mm", " mm from the last tare")
    assert refused.complaint() == f"bench: not tared: {expected}{said}"


@pytest.mark.promise("docs/reference/daemon-configuration.md", "`tare` refuses a surface that moves more.")
async def test_tare_refuses_what_moves_or_stands_still_and_writes_nothing_for_it(tmp_path: Path) -> None:
    chance = Random(3)  # noqa: S311 - noise, not secrets

    async def move(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[0] += 5  # s1 creeps

    async def noise(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        now[1] = 20_000 + chance.randrange(-30, 31)

    async with (
        pymodbus_server([20_000, 20_000], move) as moving,
        pymodbus_server([20_000, 20_000], noise) as frozen,
        pymodbus_server([20_000, 20_000]) as still,
    ):
        ports = {"moving": moving, "frozen": frozen, "still": still}
        surfaces = [configs.surface(name, configs.tcp(port)) for name, port in ports.items()]
        surfaces[1] = surfaces[1].replace("rate_hz", "noise_mm = 0.002\nrate_hz", 1)
        outcome = await command("tare", configs.write(tmp_path, *surfaces))
    assert outcome.code == 1
    first, second = outcome.err.splitlines()
    assert first.startswith("beamtouch-daemon: moving: not tared: s1 moved: standard deviation ")
    remedy = "check the sensor, or state stuck_after_ms if it works"
    assert second == f"beamtouch-daemon: frozen: not tared: s1 stuck: the counts do not change; {remedy}"
    tared = [name for name in ports if (tmp_path / f"{name}.tare.json").exists()]
    assert tared == ["still"]


@pytest.mark.timeout(60)  # what is not refused runs until it is stopped
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("tare {config} --surface press", "--surface: there is no surface press; choose one of bench"),
        ("run {config} --summary {folder}/no/s.json", "{folder}/no: no such folder; create it first"),
        *(
            (f"run {{config}} --summary {{folder}}/{file} {more}", f"{{folder}}/{file}: {READS}")
            for file, more in {
                "beamtouch.token": "",
                "bench.tare.json": "",
                "beamtouch-daemon.samples": "",
                "beamtouch-daemon.samples.zeros.json": "",
                "other.token": "--token-file {folder}/other.token",
                "other.samples": "--sample-log-file {folder}/other.samples",
            }.items()
        ),
        ("init {folder}/t --model-config {config} --source tcp://h --token-file {folder}/t", f"{{folder}}/t: {READS}"),
    ],
)
def test_wrong_input_is_one_line(tmp_path: Path, refused: Refused, words: str, said: str) -> None:
    config = configs.write(tmp_path, configs.surface())
    arguments = words.format(config=config, folder=tmp_path).split()
    assert refused(*arguments) == said.format(folder=tmp_path)


@pytest.mark.parametrize(
    "gaps",
    ["", '"rest_gap_mm": {"s1": 2.5}', '"rest_gap_mm": {"s1": null, "s2": 2.5}'],
    ids=["none", "other channels", "no number"],
)
def test_a_tare_file_that_does_not_fit_is_refused_with_a_remedy(tmp_path: Path, refused: Refused, gaps: str) -> None:
    path = tmp_path / "bench.tare.json"
    path.write_text(f'{{"surface": "bench", "taken_at": "", "readings": 1{", " if gaps else ""}{gaps}}}')
    said = refused("run", configs.write(tmp_path, configs.surface()))
    assert said.startswith(f"{path}: ")
    assert said.endswith("delete it or run beamtouch-daemon tare again")


def test_a_token_file_of_the_command_line_that_is_missing_is_named_and_may_come_later(
    tmp_path: Path, refused: Refused
) -> None:
    path = tmp_path / "elsewhere"
    said = refused("run", configs.write(tmp_path, configs.surface()), "--token-file", path, code=1)
    remedy = "publish.token_file must name a file with the service's token"
    assert said == f"token file {path}: No such file or directory; {remedy}"


async def test_a_missing_library_is_named_with_what_to_install_and_help_needs_none(tmp_path: Path) -> None:
    config, absent = (
        configs.write(tmp_path, configs.surface()),
        f"import sys; sys.modules.update(dict.fromkeys({EXTRA}))",
    )
    missing, shown = await asyncio.gather(command("run", config, code=absent), command("--help", code=absent))
    assert missing.code == 2
    assert missing.complaint().endswith(" is not installed; run: pip install 'beamtouch[daemon]'")
    assert (shown.code, shown.err) == (0, "")
    assert all(name in shown.out for name in ("run", "check", "tare", "noise"))


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
