"""The health of sensors, in a real process with its file of events: stated, kept over restarts, and on the page."""

from __future__ import annotations

import csv
import io
import signal
import time
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_models import modelfile
from service.touches import Touches

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from beamtouch_models.modelfile import ModelFile
    from browser import OpenPage
    from service.process.conftest import Service, StartService, Wait

BASELINE, CHANGED = 100, 14
BEGIN = datetime(2026, 2, 1, 12, tzinfo=UTC)
DAY = datetime(2026, 3, 3, 12, tzinfo=UTC)


def health_of(service: Service) -> dict[str, Any]:
    # Null until the service has read what it kept.
    found: dict[str, Any] | None = service.get("/surfaces/press-7").json()["health"]
    return found or {}


def post(service: Service, batch: dict[str, Any]) -> None:
    answer = service.post(batch)
    assert answer.status_code == 200, answer.text


def settled(service: Service) -> dict[str, Any]:
    """Return the health once it has been the same for two seconds: all events have been read."""
    found, since_s = health_of(service), time.monotonic()
    while time.monotonic() < since_s + 2:
        time.sleep(0.1)
        if (now := health_of(service)) != found:
            found, since_s = now, time.monotonic()
    return found


def contacts_of(service: Service) -> int:
    return int(health_of(service).get("s1", {"contacts": 0})["contacts"])


@pytest.fixture
def model(bench_model: Path) -> ModelFile:
    return modelfile.load(bench_model)


@pytest.fixture
def start(start_service: StartService, token_file: Path, tmp_path: Path, bench_model: Path) -> Callable[[], Service]:
    """A function that starts a service of the bench with the same file of events each time."""
    events, config = tmp_path / "events.db", tmp_path / "service.toml"
    config.write_text(f'[events]\nfile = "{events}"\n[surfaces.press-7]\nmodel = "{bench_model}"\nstale_ms = 60000\n')
    return lambda: start_service("--config", config, "--write-token-file", token_file)


def test_a_gain_that_falls_is_named_with_its_day_and_survives_a_kill(
    start: Callable[[], Service], model: ModelFile, wait_for: Wait, open_page: OpenPage
) -> None:
    service, touches = start(), Touches(model)
    assert health_of(service) == {}
    post(service, touches.batch(BASELINE, BEGIN, 3600))
    wait_for(lambda: contacts_of(service) == BASELINE)
    for one in health_of(service).values():
        assert not one["changed"]
        assert one["gain_low_percent"] < 0 < one["gain_high_percent"]
        assert one["zero_low_mm"] < 0 < one["zero_high_mm"]
        assert one["since"].startswith("2026-02-01T12:")
    assert service.get("/health/ready?health=true").status_code == 200

    touches.gain[1] = 0.95
    post(service, touches.batch(CHANGED, DAY))
    wait_for(lambda: health_of(service)["s2"]["changed"])
    found = settled(service)
    assert [name for name, one in found.items() if one["changed"]] == ["s2"]
    assert found["s2"]["changes"] == ["gain"]
    assert found["s2"]["gain_low_percent"] < -5 < found["s2"]["gain_high_percent"] < -3
    assert found["s2"]["since"].startswith("2026-03-03")
    text = service.get("/metrics").text
    assert 'beamtouch_channel_changed{channel="s2",surface="press-7"} 1.0' in text
    assert 'beamtouch_channel_changed{channel="s1",surface="press-7"} 0.0' in text
    assert (
        f'beamtouch_gain_change_percent{{bound="low",channel="s2",surface="press-7"}} {found["s2"]["gain_low_percent"]}'
        in text
    )
    # A problem only for those who ask.
    assert service.get("/health/ready").status_code == 200
    problem = service.get("/health/ready?health=true").json()["surfaces"]["press-7"]
    assert problem["type"].endswith(":changed-channels")
    assert problem["changed_channels"] == ["s2"]

    seen = open_page(service.url)
    seen.wait_for_text("health", "s2 has lost 5 % since 3 March")

    service.process.kill()
    again = start()
    # Contacts are read again in other groups, so that they may weigh a little more or less.
    wait_for(lambda: any(one["changed"] for one in health_of(again).values()))
    found = settled(again)
    assert [name for name, one in found.items() if one["changed"]] == ["s2"]
    assert found["s2"]["since"].startswith("2026-03-03")
    assert again.stop(signal.SIGTERM)[0] == 0
    third = start()
    wait_for(lambda: health_of(third) == found)


def test_another_characteristic_begins_anew(start: Callable[[], Service], model: ModelFile, wait_for: Wait) -> None:
    service, touches = start(), Touches(model)
    post(service, touches.batch(30, BEGIN))
    wait_for(lambda: contacts_of(service) == 30)
    touches.characteristic = "tared-again"
    post(service, touches.batch(4, DAY))
    wait_for(lambda: contacts_of(service) == 4)
    assert health_of(service)["s3"]["since"].startswith("2026-03-03")


def test_a_zero_that_creeps_is_no_gain(start: Callable[[], Service], model: ModelFile, wait_for: Wait) -> None:
    service, touches = start(), Touches(model)
    touches.readings = 4
    post(service, touches.batch(60, BEGIN))
    for step in range(10):
        touches.zero_mm[2] = 0.0008 * (step + 1)
        post(service, touches.batch(2, DAY + timedelta(minutes=10 * step)))
    post(service, touches.batch(20, DAY + timedelta(days=1)))
    wait_for(lambda: health_of(service)["s3"]["changed"])
    wait_for(lambda: health_of(service)["s3"]["zero_low_mm"] < 0.008 < health_of(service)["s3"]["zero_high_mm"])
    found = health_of(service)
    assert {name: one["changes"] for name, one in found.items()} == {"s1": [], "s2": [], "s3": ["zero"], "s4": []}


def test_best_samples_as_csv(start: Callable[[], Service], model: ModelFile, wait_for: Wait) -> None:
    service, touches = start(), Touches(model)
    batch = touches.batch(5, BEGIN)
    # Of each contact one sample has more readings than the others.
    best = [batch["samples"][12 * index + 8] for index in range(5)]
    for sample in best:
        sample["readings"] = 64
    post(service, batch)
    wait_for(lambda: contacts_of(service) == 5)
    answer = service.get("/surfaces/press-7/calibration-data")
    assert answer.headers["content-type"].startswith("text/csv")
    header, *rows = csv.reader(io.StringIO(answer.text))
    names = model.channels
    said = [f"{name}_{what}" for what in ("mm", "sd_mm") for name in names]
    assert header[:13] == ["event", "time", "model", "characteristic", "readings", *said]
    assert len(rows) == 5
    for row, sample in zip(rows, best, strict=True):
        assert row[2:5] == [model.identity, "as-taken", "64"]
        assert [float(value) for value in row[5:9]] == pytest.approx(sample["deflection_mm"], abs=1e-9)
        assert [float(value) for value in row[9:13]] == pytest.approx(
            [model.metadata.noise.reading_mm / 8] * 4, abs=1e-9
        )
        assert datetime.fromisoformat(row[1]).timestamp() == pytest.approx(sample["acquired_unix_us"] / 1e6, abs=1e-3)
    later = service.get("/surfaces/press-7/calibration-data?since=2026-02-01T12:01:30Z&limit=2").text
    assert [row[0] for row in csv.reader(io.StringIO(later))][1:] == [row[0] for row in rows[3:]]
    assert service.get("/surfaces/other/calibration-data").status_code == 404
    assert service.get("/surfaces/press-7/calibration-data?limit=0").status_code == 422
