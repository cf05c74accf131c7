"""A plate is called a plate wherever the service says what to do."""

import asyncio
from pathlib import Path

import pytest

from beamtouch_service.host.models import ModelKeeper, stamp_of
from beamtouch_service.sections import SurfaceSection
from service.bench import START_US, Bench, Row, batch_of, surface_of
from support.surfaces.small_model import PLATE_OUTPUTS, write_model

RESTING: Row = [0.0] * 4
ODD: Row = [0.5, 0.0, 0.5, 0.0]
"""No single contact explains it."""


def plate() -> Bench:
    section = SurfaceSection(unexplained_after_s=0.5, degraded_after_s=0.5)
    return Bench(surface_of(section=section, outputs=PLATE_OUTPUTS, channels=4))


def test_a_stretch_and_a_channel_out_of_range(caplog: pytest.LogCaptureFixture) -> None:
    bench = plate()
    bench.send(RESTING, *[ODD] * 200)
    problem = bench.get("/health/ready?health=true").json()["surfaces"]["press-7"]
    assert problem["detail"].endswith("Look for a second load and for anything under the plate.")
    quality = ["good", "good", "good", "out-of-range"]
    for sequence in (202, 203):
        bench.now_s += 1
        bench.send(RESTING, sequence=sequence, begin_us=START_US + 1_000_000 * (sequence - 200), quality=quality)
    stretch, channel = caplog.messages
    assert "anything that touches the plate from below" in stretch
    assert channel.endswith("check whether the sensor has moved, or something lies on the plate")


def test_samples_or_a_model_of_another_structure(tmp_path: Path) -> None:
    bench = plate()
    bench.post(batch_of(RESTING) | {"beam": "beam-2"})
    assert bench.get("/contact").json()["detail"] == (
        "The samples are of structure beam-2, the model is of plate beam-1. Give the service the model of beam-2, or "
        "the daemon the configuration that was built with this model (a plate of 400 by 300 mm; s1 100 by 50, "
        "s2 200 by 150, s3 300 by 250, s4 400 by 50)."
    )
    path = write_model(tmp_path, "top", outputs=PLATE_OUTPUTS, channels=4)
    beam = surface_of(beam="beam-2")
    keeper = ModelKeeper(beam, path, None)
    for _ in range(2):
        asyncio.run(keeper.poll(stamp_of(path)))
    assert "it is of plate beam-1, the model in use is of structure beam-2; to switch" in (beam.model_error or "")


def test_presses_that_nobody_saw() -> None:
    bench, path = plate(), "/surfaces/press-7/commissioning"
    bench.send(RESTING)
    run = bench.post(b"", path).json()["run"]
    for step in range(run["steps"]):
        bench.post(b"", f"{path}/skip?run={run['id']}&step={step}")
    (unseen, *_) = bench.get(path).json()["run"]["report"]["verdict"]
    assert unseen.endswith("check that the daemon reads this surface, and that the plate bends there.")
