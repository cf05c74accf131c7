"""A file of events that is damaged while the service runs."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

from beamtouch_models import modelfile
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.surfaces.surface import Surface
from service.event_story import RESTING, TOUCHING
from service.touches import Touches
from waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

    from service.conftest import Bench, BuildModel, MakeBatch

REASON = "file is not a database"


def overwrite(folder: Path) -> None:
    for one in folder.glob("events.db*"):
        one.write_bytes(b"no database" * 4096)


def test_contacts_go_on_and_losses_are_counted_when_the_file_of_events_is_overwritten(
    tmp_path: Path,
    make_bench: type[Bench],
    build_model: BuildModel,
    make_batch: MakeBatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    recorder = Recorder(tmp_path / "events.db")
    bench = make_bench(Surface("press-7", modelfile.load(build_model())), recorder=recorder)
    assert bench.post(make_batch(RESTING, TOUCHING, RESTING)).status_code == 200
    assert len(bench.get("/events").json()["events"]) == 1
    assert recorder.lost == 0

    overwrite(tmp_path)
    assert bench.post(make_batch(TOUCHING, RESTING, sequence=10)).status_code == 200
    refusal = bench.get("/events")
    assert (refusal.status_code, refusal.headers["retry-after"]) == (503, "1")
    assert refusal.json()["type"] == "urn:beamtouch:problem:events-away"
    assert REASON in refusal.json()["detail"]
    assert bench.get("/contact").json()["state"] == "clear"
    recorder.maintain()
    wait_until(lambda: f"the file of events cannot be maintained: {REASON}" in caplog.text)
    recorder.close()

    assert recorder.lost > 0
    assert [record.getMessage() for record in caplog.records if record.levelname == "ERROR"] == []
    assert f"events are lost: {REASON}" in caplog.text


def test_the_health_of_sensors_stays_as_it_was_when_the_file_of_events_is_overwritten(
    tmp_path: Path, make_bench: type[Bench], bench_model: Path, caplog: pytest.LogCaptureFixture
) -> None:
    surface = Surface("press-7", modelfile.load(bench_model))
    assert surface.model is not None
    recorder, touches = Recorder(tmp_path / "events.db"), Touches(surface.model)
    bench = make_bench(surface, recorder=recorder)
    assert bench.post(touches.batch(5, datetime(2026, 2, 1, tzinfo=UTC))).status_code == 200
    wait_until(lambda: surface.health is not None and bool(surface.health.channels))
    before = surface.health

    overwrite(tmp_path)
    recorder.watch(surface)
    wait_until(lambda: f"the health of sensors cannot be updated: {REASON}" in caplog.text)
    recorder.close()
    assert surface.health == before
