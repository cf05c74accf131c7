"""Rows that a service of another version wrote in another way, and damaged ones: what they say is left out, and nothing
is lost."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.surfaces.surface import Surface
from service.event_story import ODD, RESTING, TOUCHING, settle
from service.touches import Touches
from waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import Bench, BuildModel, MakeBatch

OTHERS = [json.dumps({"of": "another version"}), "{damaged"]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.db"


@pytest.fixture(params=OTHERS, ids=["another version", "damaged"])
def foreign(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def rewrite(path: Path, statement: str, foreign: str) -> None:
    """Put what nobody here can read into a column of every row."""
    with closing(sqlite3.connect(path)) as connection, connection:
        assert connection.execute(statement, [foreign]).rowcount > 0


def test_a_contact_beside_a_foreign_edge_is_recorded(
    path: Path, foreign: str, make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch
) -> None:
    model = modelfile.load(build_model())
    recorder = Recorder(path)
    assert make_bench(Surface("press-7", model), recorder=recorder).post(make_batch(RESTING, sequence=5)).is_success
    recorder.close()
    rewrite(path, "UPDATE edges SET past = ?", foreign)

    recorder = Recorder(path)
    bench = make_bench(Surface("press-7", model), recorder=recorder)
    bench.post(make_batch(RESTING, sequence=50))
    bench.post(make_batch(RESTING, TOUCHING, TOUCHING, sequence=2, age_ms=60_000))
    settle(bench)
    (event,) = bench.get("/events").json()["events"]
    assert (event["begin"], event["end"], event["samples"]) == ("touch", "lift", 2)
    assert recorder.lost == 0
    recorder.close()


def test_an_event_with_foreign_samples_is_answered_and_goes_on(
    path: Path, foreign: str, make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch
) -> None:
    model = modelfile.load(build_model())
    recorder = Recorder(path)
    bench = make_bench(Surface("press-7", model), recorder=recorder)
    bench.post(make_batch(RESTING, TOUCHING, TOUCHING, ODD, ODD, ODD, ODD, sequence=5))
    (event,) = bench.get("/events").json()["events"]
    assert event["capture"]
    recorder.close()
    rewrite(path, "UPDATE events SET path = ?", foreign)
    rewrite(path, "UPDATE events SET best = ?", foreign)
    rewrite(path, "UPDATE captures SET sample = ?", foreign)

    recorder = Recorder(path)
    bench = make_bench(Surface("press-7", model), recorder=recorder)
    bench.post(make_batch(TOUCHING, TOUCHING, RESTING, sequence=12))
    (event,) = bench.get("/events?path=true").json()["events"]
    assert (event["begin"], event["end"], len(event["path"])) == ("touch", "lift", 2)
    assert bench.get(f"/events/{event['id']}/capture").json()["samples"] == []
    assert recorder.lost == 0
    recorder.close()


def test_foreign_best_samples_are_left_out(
    path: Path, make_bench: type[Bench], bench_model: Path, caplog: pytest.LogCaptureFixture
) -> None:
    surface = Surface("press-7", modelfile.load(bench_model))
    assert surface.model is not None
    touches, recorder = Touches(surface.model), Recorder(path)
    bench = make_bench(surface, recorder=recorder)
    assert bench.post(touches.batch(5, datetime(2026, 2, 1, tzinfo=UTC))).is_success
    assert len(bench.get("/surfaces/press-7/calibration-data").text.splitlines()) == 6
    recorder.close()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE events SET best = json_set(best, '$.of', 'another version')")
        connection.execute("DELETE FROM baselines")

    surface = Surface("press-7", modelfile.load(bench_model))
    recorder = Recorder(path)
    bench = make_bench(surface, recorder=recorder)
    recorder.watch(surface)
    assert len(bench.get("/surfaces/press-7/calibration-data").text.splitlines()) == 1
    assert bench.post(touches.batch(3, datetime(2026, 2, 2, tzinfo=UTC))).is_success
    assert len(bench.get("/surfaces/press-7/calibration-data").text.splitlines()) == 4
    wait_until(lambda: surface.health is not None and bool(surface.health.channels))
    recorder.close()
    assert "cannot be updated" not in caplog.text
    assert recorder.lost == 0


def test_a_foreign_baseline_begins_anew(
    path: Path, foreign: str, make_bench: type[Bench], bench_model: Path, caplog: pytest.LogCaptureFixture
) -> None:
    surface = Surface("press-7", modelfile.load(bench_model))
    assert surface.model is not None
    recorder = Recorder(path)
    batch = Touches(surface.model).batch(5, datetime(2026, 2, 1, tzinfo=UTC))
    assert make_bench(surface, recorder=recorder).post(batch).is_success
    wait_until(lambda: surface.health is not None and bool(surface.health.channels))
    recorder.close()
    rewrite(path, "UPDATE baselines SET history = ?", foreign)

    surface = Surface("press-7", modelfile.load(bench_model))
    recorder = Recorder(path)
    recorder.watch(surface)
    wait_until(lambda: surface.health is not None and bool(surface.health.channels))
    assert "surface press-7: its health begins anew" in caplog.text
    recorder.close()
    assert recorder.lost == 0
