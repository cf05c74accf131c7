"""A rig that rings, and growing means of the daemon that arrive live or as a backlog: the events are the same."""

from __future__ import annotations

import tomllib
from contextlib import closing
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from beamtouch_daemon.config.settings import Surface as Config
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.rig.loads import Load
from beamtouch_models.rig.surface import Imperfections, VirtualSurface
from beamtouch_models.scene import load_scene
from beamtouch_service.api.app import create_app
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.samples import Sample
from beamtouch_service.surfaces.surface import Surface
from example_scenes import SCENES

if TYPE_CHECKING:
    from beamtouch_models.modelfile import ModelFile

TOUCHES, PARTS = 3, 40
TOKEN = "correct-horse-battery-staple"  # noqa: S105  # of this test only
TOUCHED_S, LIFTED_S, NOW_S = 0.5, 0.7, 1000.0


def line(model: ModelFile) -> list[Sample]:
    """Samples of touches on a beam that rings from each touch and each lift."""
    scene, _ = load_scene(SCENES / "bench.toml")
    (table,) = tomllib.loads(daemon_config(model.metadata))["surfaces"].values()
    config = Config.model_validate(table | {"source": {"kind": "modbus-tcp", "host": "127.0.0.1"}})
    assert model.metadata.filter.kind == "growing-mean"
    rig, daemon = VirtualSurface(scene, model.metadata, 1, Imperfections(damping_ratio=0.01)), Pipeline(config)
    rng, samples = np.random.default_rng(3), list[Sample]()
    low, high = scene.contact.force_range_n
    for touch in range(TOUCHES):
        load = Load(rng.uniform(*model.metadata.ranges.position_mm), rng.uniform(low, high))
        for since_s in np.arange(0.0, TOUCHED_S + LIFTED_S, 1 / config.rate_hz).tolist():
            now_s = touch * (TOUCHED_S + LIFTED_S) + since_s
            counts = rig.counts(load if since_s >= LIFTED_S else Load(None, 0.0), now_s)
            taken = daemon.process([Reading(now_s, tuple(map(float, counts)))], 1e6)
            samples += [one.sample for one in taken]
    return samples


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
    app = create_app([Surface("bench", model)], TOKEN, clock=lambda: NOW_S, recorder=recorder)
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
    samples, rng = line(bench), np.random.default_rng(5)
    straight = events(bench, samples, [], set())
    assert [(one["begin"], one["kind"]) for one in straight] == [("touch", "contact")] * TOUCHES
    cuts = sorted(rng.choice(range(1, len(samples)), PARTS, replace=False).tolist())
    lost = set(rng.choice(PARTS, PARTS // 3, replace=False).tolist())
    for one, other in zip(events(bench, samples, cuts, lost), straight, strict=True):
        for name in ("mean_position_mm", "peak_position_mm", "peak_force_n"):
            one[name] = pytest.approx(one[name], abs=1e-3)
        assert other == one
