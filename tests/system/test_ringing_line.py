"""A rig that rings, the samples of the daemon and the answers of the service: each touch is one contact."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface as Config
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.rig.imperfections import Imperfections
from beamtouch_models.rig.script import Load
from beamtouch_models.rig.surface import VirtualSurface
from beamtouch_models.scene import load_scene
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.surface import Surface
from example_scenes import SCENES

TOUCHES = 5
TOUCHED_S, LIFTED_S = 0.8, 1.2
DAMPING = 0.01


@pytest.mark.parametrize("name", ["bench", "cantilever"])
def test_a_beam_that_rings_is_touched_once_by_each_touch(name: str, built_model: Callable[[str], Path]) -> None:
    """On the bench, the heavier loads make the beam swing beyond the range of the sensors."""
    model, (scene, _) = modelfile.load(built_model(name)), load_scene(SCENES / f"{name}.toml")
    (table,) = tomllib.loads(daemon_config(model.metadata))["surfaces"].values()
    table["source"] = {"kind": "modbus-tcp", "host": "127.0.0.1"}
    config = Config.model_validate(table)
    rig = VirtualSurface(scene, model.metadata, 1, Imperfections(damping_ratio=DAMPING))
    daemon, service = Pipeline(config), Surface(name, model, stale_ms=500)
    random, begins = np.random.default_rng(3), list[list[float]]()
    low, high = scene.contact.force_range_n
    rate_hz, state = config.rate_hz, "clear"
    for touch in range(TOUCHES):
        load = Load(random.uniform(*model.metadata.ranges.position_mm), random.uniform((low + high) / 2, high))
        begin_s = touch * (TOUCHED_S + LIFTED_S)
        begins.append([])
        for since_s in np.arange(0.0, TOUCHED_S + LIFTED_S, 1 / rate_hz).tolist():
            now_s = begin_s + since_s
            counts = rig.counts(load if since_s >= LIFTED_S else Load(None, 0.0), now_s)
            for taken in daemon.process([Reading(now_s, tuple(map(float, counts)))], 1e6):
                channels = [channel.name for channel in config.channels]
                batch = Batch(boot_id="boot-0001", channels=channels, newest_age_ms=0.0, samples=[taken.sample])
                service.receive(batch, now_s)
                if service.unready(now_s) is None:
                    before, state = state, service.contact(now_s).state.value
                    if (before, state) == ("clear", "contact"):
                        begins[-1].append(round(since_s - LIFTED_S, 3))
    for touched in begins:
        assert len(touched) == 1, begins
        assert 0.0 <= touched[0] < 0.4, begins
