"""A channel that is not good for too long, as the service tells it over time."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from collections.abc import Callable

    from service.conftest import Bench, BuildModel, MakeBatch

PERIOD_S = 0.1
GOOD, BAD = ["good"] * 4, ["good", "good", "missing", "good"]


@pytest.fixture
def bench(make_bench: type[Bench], build_model: BuildModel) -> Bench:
    return make_bench(Surface("press-7", modelfile.load(build_model(channels=4)), SurfaceSection(degraded_after_s=2.0)))


@pytest.fixture
def send(bench: Bench, make_batch: MakeBatch) -> Callable[[float, list[str]], None]:
    """Send samples of this quality for so many seconds."""
    sent = 0

    def send_for(seconds: float, quality: list[str]) -> None:
        nonlocal sent
        for _ in range(round(seconds / PERIOD_S)):
            sent += 1
            bench.now_s += PERIOD_S
            row = [0.0, 0.0, None if quality is BAD else 0.0, 0.0]
            assert bench.post(make_batch(row, sequence=sent, quality=quality)).status_code == 200

    return send_for


def is_out(bench: Bench) -> bool:
    """Return whether s3 is out; every door that has no figures of its own must agree."""
    out = "s3" in bench.get("/surfaces/press-7").json()["channels_out"]
    assert (bench.get("/health/ready?health=true").status_code == 503) == out
    assert bench.get("/health/ready").status_code == 200
    assert ("degraded" in bench.get("/contact").json()["notes"]) == out
    value = f'beamtouch_channel_out{{channel="s3",surface="press-7"}} {float(out)}'
    assert value in bench.get("/metrics").text
    return out


def test_a_loose_cable_is_out_if_it_is_off_for_more_than_half_of_the_time(
    bench: Bench, send: Callable[[float, list[str]], None], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "beamtouch.service")
    for _ in range(20):
        send(0.4, BAD)
        send(0.6, GOOD)
    assert not is_out(bench)
    for _ in range(20):
        send(0.7, BAD)
        send(0.3, GOOD)
    assert is_out(bench)
    for _ in range(20):
        send(0.3, BAD)
        send(0.7, GOOD)
    assert not is_out(bench)
    assert [message.partition(" since ")[0] for message in caplog.messages] == [
        "surface press-7: channel s3 has been missing",
        "surface press-7: channel s3 is good again; it had been missing",
    ]


def test_a_pause_without_samples_counts_for_nothing(bench: Bench, send: Callable[[float, list[str]], None]) -> None:
    send(1.0, BAD)
    bench.now_s += 3600
    assert "beamtouch_channel_out{" not in bench.get("/metrics").text
    send(0.2, BAD)
    assert not is_out(bench)
    send(1.5, BAD)
    assert is_out(bench)


def test_the_misfit_has_its_scale_beside_it(bench: Bench, send: Callable[[float, list[str]], None]) -> None:
    assert bench.get("/surfaces/press-7").json()["misfit_limit"] is None
    send(0.1, GOOD)
    found, contact = bench.get("/surfaces/press-7").json(), bench.get("/contact").json()
    assert found["misfit"] == contact["misfit"] <= found["misfit_limit"]
    assert "misfit_limit" not in contact
