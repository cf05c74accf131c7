"""A rig that rings, the samples of the daemon, and what the service says of them, also after pauses."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np

from beamtouch_common.outline import BEAM_AXIS
from beamtouch_daemon.config.settings import Surface as Config
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.design.building.daemon_config import daemon_config
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.loads import Load
from beamtouch_models.lab.rig.surface import Imperfections, VirtualSurface
from beamtouch_models.runtime import ModelFile
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.view import View
from support.surfaces.example_scenes import SCENES

TOUCHES = 3
TOUCHED_S, LIFTED_S = 0.8, 0.8
DAMPING = 0.01
PAUSE, PAUSED_EVERY = 12, 80
"""Readings, at 200 a second: pauses of 60 ms each 0.4 s."""


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


def answers(model: ModelFile, pause: int = 0) -> Iterator[tuple[Moment, View]]:
    """Yield what the service answers to each sample."""
    service = Surface("bench", model)
    for moment in line(model, pause):
        batch = Batch(boot_id="boot-0001", channels=model.channels, newest_age_ms=0.0, samples=[moment.sample])
        service.receive(batch, moment.now_s)
        if (view := service.view(moment.now_s)).problem is None:
            yield moment, view


def test_a_beam_that_rings_is_touched_once_by_each_touch(bench: ModelFile) -> None:
    begins, state = [list[float]() for _ in range(TOUCHES)], "clear"
    for moment, view in answers(bench):
        before, state = state, str(view.state)
        if (before, state) == ("clear", "contact"):
            begins[moment.touch].append(round(moment.since_s, 3))
    for touched in begins:
        assert len(touched) == 1, begins
        assert 0.0 <= touched[0] < 0.4, begins


def test_no_contact_on_a_reading_or_two_is_sure_of_itself_while_a_module_pauses_and_the_beam_rings(
    bench: ModelFile,
) -> None:
    touched = [
        (moment, view) for moment, view in answers(bench, PAUSE) if view.state == "contact" and moment.load.force_n
    ]
    sure = [(moment, view) for moment, view in touched if "unsteady" not in view.notes]
    assert [one for one in sure if (one[0].sample.readings or 0) < 4] == []
    held = [
        isinstance(at_mm := moment.load.place_mm, float) and position.low <= at_mm <= position.high
        for moment, view in touched
        if (position := view.place.get(BEAM_AXIS))
    ]
    assert len(held) > 200
    assert np.mean(held) > 0.95
