"""A hall that warms: what the daemon says of zeros that drift, with a rig whose zeros do."""

import re
import tomllib
from pathlib import Path

import pytest

from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.modelfile import ModelFile
from support.programs.forked_line import rig
from support.surfaces.example_scenes import SCENES

from .process import command, started
from .service import TOKEN

pytestmark = [pytest.mark.anyio, pytest.mark.long]

RATE, MAX_MM = 40, 0.05
"""Drift of the rig [um/min], and the distance from the last tare up to which the daemon follows it."""


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
