"""A rig that rings, the samples of the daemon and the answers of the service, also while readings are lost."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from beamtouch_daemon.config.settings import Surface as Config
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.rig.loads import Load
from beamtouch_models.rig.surface import Imperfections, VirtualSurface
from beamtouch_models.scene import load_scene
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.surface import Surface
from example_scenes import SCENES

TOUCHES = 3
TOUCHED_S, LIFTED_S = 0.8, 1.2
DAMPING = 0.01


PAUSE, PAUSED_EVERY = 12, 80
"""Readings, at 200 a second: pauses of 60 ms each 0.4 s."""


@dataclass(frozen=True)
class Answer:
    """What the service says on a reading of a rig that is touched and lifted in turn."""

    load: Load
    touch: int
    """Number of the touch."""
    since_s: float
    """Since the touch; negative before it."""
    contact: Contact
    readings: int | None
    """In the sample."""


def answers(path: Path, pause: int = 0) -> Iterator[Answer]:
    """Yield the answers of a service to the samples of a rig with a beam that rings; pauses are in readings."""
    model, (scene, _) = modelfile.load(path), load_scene(SCENES / "bench.toml")
    (table,) = tomllib.loads(daemon_config(model.metadata))["surfaces"].values()
    table["source"] = {"kind": "modbus-tcp", "host": "127.0.0.1"}
    config = Config.model_validate(table)
    rig = VirtualSurface(scene, model.metadata, 1, Imperfections(damping_ratio=DAMPING))
    daemon, service = Pipeline(config), Surface("bench", model)
    random = np.random.default_rng(3)
    low, high = scene.contact.force_range_n
    channels, number, lost = [channel.name for channel in config.channels], count(), 0
    for touch in range(TOUCHES):
        load = Load(random.uniform(*model.metadata.ranges.position_mm), random.uniform((low + high) / 2, high))
        begin_s = touch * (TOUCHED_S + LIFTED_S)
        for since_s in np.arange(0.0, TOUCHED_S + LIFTED_S, 1 / config.rate_hz).tolist():
            now_s, there = begin_s + since_s, load if since_s >= LIFTED_S else Load(None, 0.0)
            counts = rig.counts(there, now_s)
            if next(number) % PAUSED_EVERY < pause:
                lost += 1
                continue
            for taken in daemon.process([Reading(now_s, tuple(map(float, counts)), lost)], 1e6):
                batch = Batch(boot_id="boot-0001", channels=channels, newest_age_ms=0.0, samples=[taken.sample])
                service.receive(batch, now_s)
                if service.unready(now_s) is None:
                    contact = service.contact(now_s)
                    yield Answer(there, touch, since_s - LIFTED_S, contact, taken.sample.readings)
            lost = 0


def test_a_beam_that_rings_is_touched_once_by_each_touch(bench_model: Path) -> None:
    """The heavier loads make the beam swing beyond the range of the sensors."""
    begins, state = [list[float]() for _ in range(TOUCHES)], "clear"
    for answer in answers(bench_model):
        before, state = state, answer.contact.state.value
        if (before, state) == ("clear", "contact"):
            begins[answer.touch].append(round(answer.since_s, 3))
    for touched in begins:
        assert len(touched) == 1, begins
        assert 0.0 <= touched[0] < 0.4, begins


def test_no_contact_on_a_reading_or_two_is_sure_of_itself_while_a_module_pauses_and_the_beam_rings(
    bench_model: Path,
) -> None:
    said = [one for one in answers(bench_model, PAUSE) if one.contact.state == "contact"]
    touched = [one for one in said if one.load.force_n]
    sure = [one for one in touched if "unsteady" not in one.contact.notes]
    assert [one for one in sure if (one.readings or 0) < 4] == []
    held = [
        one.contact.position_low_mm <= (one.load.position_mm or 0.0) <= one.contact.position_high_mm
        for one in touched
        if one.contact.position_low_mm is not None and one.contact.position_high_mm is not None
    ]
    assert len(held) > 200
    assert np.mean(held) > 0.95
