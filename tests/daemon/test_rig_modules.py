"""Configurations written for real modules read the rig, as long as it plays their registers; so does mbpoll.

mbpoll is a client on libmodbus, which shares no code with daemon and rig.
"""

import json
import re
from pathlib import Path

import pytest

from support.programs.forked_line import Rig, rig
from support.programs.toolchain import run
from support.running.debian_parts import require
from support.surfaces.configs import write
from support.surfaces.example_scenes import SCENES

from .process import command

pytestmark = pytest.mark.anyio

SCENE = SCENES / "bench.toml"
LINE = ("-b", "115200", "-P", "none")
FLOATS = ("--unit", "5", "--function", "3", "--register", "100", "--type", "f32", "--byte-order", "CDAB")


def configuration(folder: Path, source: str, channel: str) -> Path:
    channels = "".join(
        f"""[[surfaces.bench.channels]]
name = "s{index + 1}"
{channel.format(index=index, two=100 + 2 * index, four=100 + 4 * index)}
gain_mm_per_count = 5.722133211261158e-05
offset_mm = 0.625
rest_gap_mm = 3.63
range_mm = [1.0, 4.0]
"""
        for index in range(4)
    )
    return write(folder, f"[surfaces.bench]\nrate_hz = 10.0\n[surfaces.bench.source]\n{source}\n{channels}")


def source_of(kind: str, beam: Rig) -> str:
    """Return the table of the line of a rig."""
    place = f'host = "127.0.0.1"\nport = {beam.place}' if kind == "modbus-tcp" else f'port = "{beam.place}"'
    return f'kind = "{kind}"\n{place}\ntimeout_ms = 30000\n'


def where(kind: str, folder: Path) -> str | Path:
    return "127.0.0.1:0" if kind == "modbus-tcp" else folder / "line"


@pytest.mark.promise(
    "docs/reference/rig.md",
    "A request for another unit gets exception 11 over TCP, and silence on a serial bus.",
)
@pytest.mark.parametrize(
    ("kind", "played", "source", "channel"),
    [
        ("modbus-tcp", ("--unit", "255"), 'module = "iologik-e1240"\nunit = 255', "input = {index}"),
        ("modbus-tcp", FLOATS, 'function = 3\nunit = 5\nbyte_order = "CDAB"', 'register = {two}\ntype = "f32"'),
        (
            "modbus-tcp",
            ("--unit", "5", "--register", "100", "--type", "f64", "--byte-order", "DCBA"),
            'unit = 5\nbyte_order = "DCBA"',
            'register = {four}\ntype = "f64"',
        ),
        ("modbus-rtu", ("--unit", "17"), 'module = "waveshare-8ch"\nunit = 17', "input = {index}"),
    ],
)
async def test_a_configuration_for_a_module_reads_the_rig_and_another_unit_is_silent(
    bench_model: Path, tmp_path: Path, kind: str, played: tuple[str, ...], source: str, channel: str
) -> None:
    with rig(SCENE, bench_model, f"--{kind}", where(kind, tmp_path), "--by-hand", *played) as beam:
        text = source_of(kind, beam) + source
        done = await command("check", configuration(tmp_path, text, channel))
        other = text.replace("30000", "100").replace(f"unit = {played[1]}", "unit = 18")
        silent = await command("check", configuration(tmp_path, other, channel))
    assert done.code == 0, done.err
    assert done.out.count("good") == 4
    assert silent.code == 1
    assert "unit 18" in silent.err
    assert "does not answer" in silent.err


@pytest.mark.parametrize("kind", ["modbus-tcp", "modbus-rtu"])
async def test_mbpoll_and_the_daemon_read_the_same_of_the_rig(bench_model: Path, tmp_path: Path, kind: str) -> None:
    mbpoll = require("mbpoll", "mbpoll")
    with rig(SCENE, bench_model, f"--{kind}", where(kind, tmp_path), "--by-hand", "--no-ringing") as beam:
        beam.put("200 20")
        target = ["tcp", "-p", beam.place, "127.0.0.1"] if kind == "modbus-tcp" else ["rtu", *LINE, beam.place]
        said = run(mbpoll, "-a", "1", "-t", "3", "-r", "1", "-c", "4", "-1", "-o", "5", "-m", *target)
        done = await command("check", configuration(tmp_path, source_of(kind, beam), "register = {index}"), "--json")
    foreign = [int(count) for count in re.findall(r"^\[\d\]:\s+(\d+)", said, re.MULTILINE)]
    ours = [channel["counts"] for channel in json.loads(done.out)["surfaces"]["bench"]["channels"]]
    spread = max(ours) - min(ours)
    assert spread > 1000
    assert foreign == pytest.approx(ours, abs=0.1 * spread)  # a tenth of it is ten deviations of the noise
