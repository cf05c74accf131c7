"""Missed contacts along the beam, as the model states them, against many samples of its own graph."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.accuracy.evaluation import at_noise, estimates
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.seen_along import seen_along
from beamtouch_models.accuracy.touch_thresholds import size_per_n, smallest_force_n
from beamtouch_models.building.checks import seen_places
from beamtouch_models.building.model_prior import prior_of_model
from beamtouch_models.building.sensor_rules import sample_errors
from beamtouch_models.description import summary, unseen
from beamtouch_models.detection import UNSEEN_N, detection_of, missed_shares
from beamtouch_models.metadata import SmallestForce
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.scene import load_scene
from example_scenes import SCENES
from in_process import Command

DRAWS = 4096


@pytest.mark.parametrize("share", [0.7, 0.85, 1.0])
def test_the_graph_misses_as_many_as_stated(bench: ModelFile, share: float) -> None:
    """Samples of a part of the smallest force that is seen, at both ends of the range and between."""
    metadata, prior = bench.metadata, prior_of_model(bench.metadata)
    stated, rng = detection_of(metadata), np.random.default_rng(7)
    assert stated is not None
    at, position = [0, 5, 12, 24], np.array(stated.position_mm)
    smallest, size = np.array(stated.smallest_force_n), size_per_n(prior, position)
    for index in at:
        force = share * smallest[index]
        expected = missed_shares(force, smallest[[index]], size[[index]])[0]
        clean = np.tile(force * prior.table(position[[index]]), (DRAWS, 1))
        zero, noise = rng.normal(size=(2, DRAWS, prior.channels)) * [[prior.zero_mm], [np.full(4, prior.noise_mm)]]
        odds = estimates(bench, prior, clean + zero + noise)["contact_log_odds"]
        missed = float((odds <= metadata.thresholds.touch[-1]).mean())
        # Noise beside the contact's own direction adds to its odds: fewer are missed, by up to half a deviation.
        assert missed < expected + 0.02
        assert missed > missed_shares(force + 0.5 / size[index], smallest[[index]], size[[index]])[0] - 0.02


def test_at_the_smallest_force_one_of_twenty_is_missed_and_without_any_force_nearly_all() -> None:
    smallest, size = np.array([2.0, 5.0, UNSEEN_N]), np.array([10.0, 4.0, 0.0])
    assert missed_shares(2.0, smallest, size) == pytest.approx([0.05, 1.0, 1.0], abs=1e-4)
    # Abramowitz & Stegun, table 26.1: Phi(-1.645 - 2) = 1.337e-4.
    assert missed_shares(2.2, smallest[:1], size[:1]) == pytest.approx([1.337e-4], rel=1e-3)


@pytest.mark.usefixtures("few_at_rest")
def test_build_and_evaluate_state_the_same_along_the_beam(
    bench: ModelFile, bench_model: Path, design_sensors_here: Command
) -> None:
    described = json.loads(design_sensors_here("inspect", bench_model, "--json").stdout)["detection"]
    (evaluated,) = json.loads(design_sensors_here("evaluate", bench_model, "--draws", 200, "--json").stdout)[
        "evaluations"
    ]
    found = evaluated["detection"]
    assert described["force_n"] == found["force_n"] == 2.0
    assert described["false_contacts_per_day"] == found["false_contacts_per_day"] == pytest.approx(1 / 30)
    assert described["smallest_force_n"] == bench.metadata.smallest_force.force_n
    between = np.interp(described["position_mm"], found["position_mm"], found["smallest_force_n"])
    assert between == pytest.approx(described["smallest_force_n"], rel=0.03)
    assert max(described["missed"]) == pytest.approx(max(found["missed"]), abs=1e-6)
    assert evaluated["smallest_force_n"] == [min(found["smallest_force_n"]), max(found["smallest_force_n"])]


def test_where_the_beam_does_not_move_no_force_is_seen_in_so_many_words(bench: ModelFile) -> None:
    """The middle support of two spans is one of the places at which the smallest force is stated."""
    scene, _ = load_scene(SCENES / "two-spans.toml")
    prior = Prior.real(influence_of(scene), np.array([150.0, 300.0, 450.0, 600.0, 800.0]), sample_errors(scene, 0.001))
    places = seen_places(prior)
    forces = np.minimum(smallest_force_n(prior, 20.0, places), UNSEEN_N)
    assert places[32] == pytest.approx(500)
    assert forces[32] > 1e6
    seen = SmallestForce(position_mm=places.tolist(), force_n=forces.tolist())
    ranges = bench.metadata.ranges.model_copy(update={"force_n": scene.contact.force_range_n})
    metadata = bench.metadata.model_copy(update={"smallest_force": seen, "ranges": ranges})
    assert unseen(metadata).endswith("at 500 mm the beam hardly moves, and no force is seen")
    heavy = metadata.ranges.model_copy(update={"force_n": (300.0, 1000.0)})
    assert forces[31] < 300
    assert unseen(metadata.model_copy(update={"ranges": heavy})).endswith(
        "at 500 mm: there the beam hardly moves, and no force is seen"
    )
    ends = SmallestForce(position_mm=[0.0, 200.0], force_n=[UNSEEN_N, 1.0])
    told = summary(metadata.model_copy(update={"smallest_force": ends}), "bench", bench.outputs)
    assert "N at the best place, none and 1 N at the ends of the range;" in told
    assert not re.search(r"e\+\d\d", unseen(metadata) + told)


def test_more_noise_misses_more(bench: ModelFile) -> None:
    prior = prior_of_model(bench.metadata)
    usual, noisy = (seen_along(bench, at_noise(prior, times * prior.noise_mm)) for times in (1, 20))
    assert usual is not None
    assert noisy is not None
    assert max(noisy.missed) > max(usual.missed)
    assert min(noisy.smallest_force_n) > 10 * min(usual.smallest_force_n)
    assert seen_along(bench, at_noise(prior, 0.0)) is None
