"""A rig that rings, and growing means of the daemon that arrive in any order: the events are the same."""

from __future__ import annotations

import tomllib
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from fastapi.testclient import TestClient

from beamtouch_daemon.config.settings import Surface as Config
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.rig.imperfections import Imperfections
from beamtouch_models.rig.script import Load
from beamtouch_models.rig.surface import VirtualSurface
from beamtouch_models.scene import load_scene
from beamtouch_service.api.app import create_app
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.surface import Surface
from example_scenes import SCENES
from waiting import wait_until

if TYPE_CHECKING:
    from beamtouch_models.modelfile import ModelFile

TOUCHES, PARTS, ORDERS = 4, 40, 3
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


def events(model: ModelFile, samples: list[Sample], parts: list[tuple[int, int]]) -> list[dict[str, Any]]:
    """Deliver parts of the samples in this order; return the events, without what depends on the way they are cut."""
    surface = Surface("bench", model, stale_ms=500)
    app = create_app([surface], None, clock=lambda: NOW_S)
    recorder, newest = app.context.recorder, -1
    for first, last in parts:
        # Those before the newest are stated as old, too.
        age_ms = 0.0 if last > newest else 60_000.0
        newest = max(newest, last)
        batch = Batch(boot_id="boot-0001", channels=model.channels, newest_age_ms=age_ms, samples=samples[first:last])
        surface.receive(batch, NOW_S)
    wait_until(lambda: not recorder.late_waiting)
    with TestClient(app) as client:
        found = client.get("/events?limit=1000").json()["events"]
    # The mean is that of samples that share no readings, of each part.
    left_out = ("id", "mean_position_mm", "samples")
    return [{name: one[name] for name in one if name not in left_out} for one in reversed(found)]


def test_growing_means_of_a_beam_that_rings_give_the_same_events_in_any_order(bench: ModelFile) -> None:
    samples, rng = line(bench), np.random.default_rng(5)
    straight = events(bench, samples, [(0, len(samples))])
    assert [(one["begin"], one["kind"]) for one in straight] == [("touch", "contact")] * TOUCHES
    for _ in range(ORDERS):
        cuts = sorted(rng.choice(range(1, len(samples)), PARTS, replace=False).tolist())
        parts = list(pairwise([0, *cuts, len(samples)]))
        # The last contact goes on, so that its end depends on which part comes last.
        order = [*rng.permutation(len(parts) - 1).tolist(), -1]
        assert events(bench, samples, [parts[place] for place in order]) == straight
