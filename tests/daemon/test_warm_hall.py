"""A hall that warms: what the daemon says of zeros that drift, with a rig whose zeros do."""

import re
import tomllib
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pytest

from beamtouch_models.design.building.daemon_config import daemon_config
from beamtouch_models.runtime import ModelFile
from support.programs.forked_line import rig
from support.surfaces import configs
from support.surfaces.example_scenes import SCENES

from .devices import pymodbus_server
from .noisy_beam import NoisyBeam
from .process import command, started
from .service import TOKEN, Service, serving

pytestmark = [pytest.mark.anyio, pytest.mark.long]

RATE, MAX_MM = 160, 0.05
"""Drift of the rig [um/min], and the distance from the last tare up to which the daemon follows it."""


@pytest.mark.parametrize(
    ("channels", "who"), [((1.0, 1.0), "its zeros drift"), ((0.0, 1.0), "the zero of s2 drifts")], ids=["all", "one"]
)
async def test_zeros_that_drift_faster_than_is_stated_are_told_with_their_rate(
    channels: tuple[float, float], who: str, tmp_path: Path
) -> None:
    beam, begun_s = NoisyBeam(), list[float]()

    async def warming(*given: Any) -> None:  # noqa: ANN401
        begun_s.append(monotonic())  # of the first reading: a machine may take long to start the daemon
        beam.um = 20 / 60 * (begun_s[-1] - begun_s[0]) * np.array(channels)
        await beam.answer(*given)

    tracking = "[surfaces.bench.zero_tracking]\ndrift_um_per_min = 5\nmax_mm = 0.05\n"
    async with serving(Service()) as service, pymodbus_server([20_000, 20_000], warming) as port:
        surface = configs.surface(source=configs.tcp(port), rate_hz=50.0)
        surface = surface.replace("rate_hz", "noise_mm = 0.002\nrate_hz", 1)
        config = configs.write(tmp_path, surface + tracking, url=service.url)
        async with started("run", config) as daemon:
            said = await daemon.said("looks the same\n")
            await daemon.stop()
    told = re.search(rf"bench: {who} at \+(\S+) um/min, (\S+) times what is stated, and answers", said)
    assert told is not None, said
    assert float(told[1]) == pytest.approx(20, rel=0.5)
    assert float(told[2]) == pytest.approx(4, rel=0.5)


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/drift.md", "The daemon says when the zeros come near the end of what it follows")
async def test_zeros_that_drift_far_from_the_tare_are_told_and_a_tare_brings_them_back(
    bench: ModelFile, bench_model: Path, tmp_path: Path
) -> None:
    warm = tmp_path / "warm.toml"
    warm.write_text(f"drift_um_per_min = [{RATE}, {RATE}, {RATE}, {RATE}]\n")
    with rig(
        SCENES / "bench.toml", bench_model, "--modbus-tcp", "127.0.0.1:0", "--by-hand", "--imperfections", warm
    ) as beam:
        text = re.sub(r"(?m)^port = \d+", f"port = {beam.place}", daemon_config(bench.metadata))
        text = re.sub(r"(?m)^drift_um_per_min = \S+", f"drift_um_per_min = {RATE}", text)
        text = re.sub(r"(?m)^max_mm = \S+", f"max_mm = {MAX_MM}", text)
        assert tomllib.loads(text)["surfaces"]["bench"]["zero_tracking"]["max_mm"] == MAX_MM
        config = tmp_path / "daemon.toml"
        config.write_text(text)
        (tmp_path / "beamtouch.token").write_text(f"{TOKEN}\n")
        tared = await command("tare", config, "--accept-change")
        async with started("run", config) as daemon:
            said = await daemon.said("and tare\n")
            await daemon.stop()
    assert tared.code == 0, tared.err
    far = re.search(
        r"bench: its zeros have drifted by up to (\S+) um since the last tare; no more than 50 um are", said
    )
    assert far is not None, said
    assert 30 < float(far[1]) <= 50
