"""Configurations written for real modules read the rig, as long as the rig plays their registers."""

from pathlib import Path

import pytest

from example_scenes import SCENES
from forked_line import rig

from .configs import write
from .process import command

pytestmark = pytest.mark.anyio

SCENE = SCENES / "bench.toml"
FLOATS = ("--unit", "5", "--function", "3", "--register", "100", "--type", "f32", "--byte-order", "CDAB")
TCP = 'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = 30000\n'
RTU = 'kind = "modbus-rtu"\nport = "{path}"\ntimeout_ms = {timeout_ms}\n'


def configuration(folder: Path, source: str, channel: str) -> Path:
    channels = "".join(
        f"""[[surfaces.bench.channels]]
name = "s{index + 1}"
{channel.format(index=index, two=100 + 2 * index)}
gain_mm_per_count = 5.722133211261158e-05
offset_mm = 0.625
rest_gap_mm = 3.63
range_mm = [1.0, 4.0]
"""
        for index in range(4)
    )
    return write(folder, f"[surfaces.bench]\nrate_hz = 10.0\n[surfaces.bench.source]\n{source}\n{channels}")


@pytest.mark.parametrize(
    ("played", "source", "channel"),
    [
        (("--unit", "255"), 'module = "iologik-e1240"\nunit = 255', "input = {index}"),
        (FLOATS, 'function = 3\nunit = 5\nbyte_order = "CDAB"', 'register = {two}\ntype = "f32"'),
    ],
)
async def test_a_configuration_for_a_tcp_module_reads_the_rig(
    bench_model: Path, tmp_path: Path, played: tuple[str, ...], source: str, channel: str
) -> None:
    with rig(SCENE, bench_model, "--modbus-tcp", "127.0.0.1:0", "--by-hand", *played) as beam:
        done = await command("check", configuration(tmp_path, TCP.format(port=beam.place) + source, channel))
    assert done.code == 0, done.err
    assert done.out.count("good") == 4


async def test_a_configuration_for_an_rtu_module_reads_the_rig_and_another_unit_is_silent(
    bench_model: Path, tmp_path: Path
) -> None:
    with rig(SCENE, bench_model, "--modbus-rtu", tmp_path / "line", "--by-hand", "--unit", "17") as beam:
        module = RTU.format(path=beam.place, timeout_ms=30_000) + 'module = "waveshare-8ch"\nunit = '
        done = await command("check", configuration(tmp_path, module + "17", "input = {index}"))
        other = module.replace("30000", "100") + "18"
        silent = await command("check", configuration(tmp_path, other, "input = {index}"))
    assert done.code == 0, done.err
    assert done.out.count("good") == 4
    assert silent.code == 1
    assert "unit 18" in silent.err
    assert "does not answer" in silent.err
