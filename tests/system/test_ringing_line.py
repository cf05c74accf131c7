"""A rig that rings, the samples of the daemon, and what the service says of them, also after pauses and late."""

import tomllib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import count, pairwise
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from beamtouch_daemon.config.settings import Surface as Config
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.rig.loads import Load
from beamtouch_models.rig.surface import Imperfections, VirtualSurface
from beamtouch_models.scene import load_scene
from beamtouch_service.api.app import create_app
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.surface import Surface
from example_scenes import SCENES

TOUCHES = 3
TOUCHED_S, LIFTED_S = 0.8, 0.8
DAMPING = 0.01
PAUSE, PAUSED_EVERY = 12, 80
"""Readings, at 200 a second: pauses of 60 ms each 0.4 s."""
PARTS = 40
TOKEN = "correct-horse-battery-staple"  # noqa: S105  # of this test only


@dataclass(frozen=True)
class Moment:
    """A reading of a rig that is touched and lifted in turn, and the sample that the daemon makes of it."""

    load: Load
    touch: int
    """Number of the touch."""
    since_s: float
    """Since the touch; negative before it."""
    now_s: float
    sample: Sample


def line(model: ModelFile, pause: int = 0) -> Iterator[Moment]:
    """Yield the samples of touches on a beam that rings from each touch and each lift; pauses are in readings.

    The heavier loads make the beam swing beyond the range of the sensors.
    """
    scene, _ = load_scene(SCENES / "bench.toml")
    (table,) = tomllib.loads(daemon_config(model.metadata))["surfaces"].values()
    config = Config.model_validate(table | {"source": {"kind": "modbus-tcp", "host": "127.0.0.1"}})
    assert model.metadata.filter.kind == "growing-mean"
    rig, daemon = VirtualSurface(scene, model.metadata, 1, Imperfections(damping_ratio=DAMPING)), Pipeline(config)
    rng, number, lost = np.random.default_rng(3), count(), 0
    low, high = scene.contact.force_range_n
    for touch in range(TOUCHES):
        load = Load(rng.uniform(*model.metadata.ranges.position_mm), rng.uniform((low + high) / 2, high))
        for since_s in np.arange(0.0, TOUCHED_S + LIFTED_S, 1 / config.rate_hz).tolist():
            now_s = touch * (TOUCHED_S + LIFTED_S) + since_s
            there = load if since_s >= LIFTED_S else Load(None, 0.0)
            counts = rig.counts(there, now_s)
            if next(number) % PAUSED_EVERY < pause:
                lost += 1
                continue
            for taken in daemon.process([Reading(now_s, tuple(map(float, counts)), lost)], 1e6):
                yield Moment(there, touch, since_s - LIFTED_S, now_s, taken.sample)
            lost = 0


def answers(model: ModelFile, pause: int = 0) -> Iterator[tuple[Moment, Contact]]:
    """Yield what the service answers to each sample."""
    service = Surface("bench", model)
    for moment in line(model, pause):
        batch = Batch(boot_id="boot-0001", channels=model.channels, newest_age_ms=0.0, samples=[moment.sample])
        service.receive(batch, moment.now_s)
        if service.unready(moment.now_s) is None:
            yield moment, service.contact(moment.now_s)


def test_a_beam_that_rings_is_touched_once_by_each_touch(bench: ModelFile) -> None:
    begins, state = [list[float]() for _ in range(TOUCHES)], "clear"
    for moment, contact in answers(bench):
        before, state = state, contact.state.value
        if (before, state) == ("clear", "contact"):
            begins[moment.touch].append(round(moment.since_s, 3))
    for touched in begins:
        assert len(touched) == 1, begins
        assert 0.0 <= touched[0] < 0.4, begins


def test_no_contact_on_a_reading_or_two_is_sure_of_itself_while_a_module_pauses_and_the_beam_rings(
    bench: ModelFile,
) -> None:
    touched = [
        (moment, contact)
        for moment, contact in answers(bench, PAUSE)
        if contact.state == "contact" and moment.load.force_n
    ]
    sure = [(moment, contact) for moment, contact in touched if "unsteady" not in contact.notes]
    assert [one for one in sure if (one[0].sample.readings or 0) < 4] == []
    held = [
        contact.position_low_mm <= (moment.load.position_mm or 0.0) <= contact.position_high_mm
        for moment, contact in touched
        if contact.position_low_mm is not None and contact.position_high_mm is not None
    ]
    assert len(held) > 200
    assert np.mean(held) > 0.95


class Sender:
    """Sends samples to a service, and keeps them until they are on record."""

    def __init__(self, model: ModelFile, client: TestClient, samples: list[Sample]) -> None:
        self._client, self._samples = client, [one.model_dump(mode="json") for one in samples]
        self._body = {"boot_id": "boot-0001", "channels": model.channels, "oldest": 1}

    def live(self, first: int, last: int) -> None:
        self._post({"samples": self._samples[first:last], "newest_age_ms": 0.0})

    def backlog(self, limit: int) -> bool:
        """Send some of what the record lacks; return whether it lacks anything more."""
        expected: int = self._post({"samples": [], "backlog": True})["expected"]
        self._post({"samples": self._samples[expected - 1 :][:limit], "backlog": True})
        return expected <= len(self._samples)

    def _post(self, members: dict[str, Any]) -> dict[str, Any]:
        headers = {"Authorization": f"Bearer {TOKEN}"}
        answer = self._client.post("/surfaces/bench/samples", json=self._body | members, headers=headers)
        assert answer.status_code == 200, answer.text
        receipt: dict[str, Any] = answer.json()
        return receipt


def events(model: ModelFile, samples: list[Sample], cuts: list[int], lost: set[int]) -> list[dict[str, Any]]:
    """Deliver samples in parts, of which those of some numbers come as a backlog only; return the events."""
    recorder = Recorder()
    app = create_app([Surface("bench", model)], TOKEN, clock=lambda: 1000.0, recorder=recorder)
    with closing(recorder), TestClient(app) as client:
        sender = Sender(model, client, samples)
        for place, (first, last) in enumerate(pairwise([0, *cuts, len(samples)])):
            if place not in lost:
                sender.live(first, last)
            elif place % 2:
                sender.backlog(PARTS)
        while sender.backlog(700):
            pass
        return [one | {"id": 0} for one in reversed(client.get("/events?limit=1000").json()["events"])]


def test_growing_means_of_a_beam_that_rings_give_the_same_events_however_they_arrive(bench: ModelFile) -> None:
    samples, rng = [moment.sample for moment in line(bench)], np.random.default_rng(5)
    straight = events(bench, samples, [], set())
    assert [(one["begin"], one["kind"]) for one in straight] == [("touch", "contact")] * TOUCHES
    cuts = sorted(rng.choice(range(1, len(samples)), PARTS, replace=False).tolist())
    lost = set(rng.choice(PARTS, PARTS // 3, replace=False).tolist())
    for one, other in zip(events(bench, samples, cuts, lost), straight, strict=True):
        for name in ("mean_position_mm", "peak_position_mm", "peak_force_n"):
            one[name] = pytest.approx(one[name], abs=1e-3)
        assert other == one
