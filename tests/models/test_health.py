"""How gains and zeros change: contacts of the bench with sensors that change, by fixed seeds."""

import json
from collections.abc import Sequence

import numpy as np
import pytest

from beamtouch_models.runtime import BestSample, Health, ModelFile
from beamtouch_models.runtime.health.changes import Block, History, find_changes
from models.drawn_contacts import SuccessiveContacts

BASELINE = 100


@pytest.fixture(scope="session")
def drawn(bench: ModelFile) -> SuccessiveContacts:
    return SuccessiveContacts(bench)


def changed(health: Health) -> list[tuple[int, str]]:
    """The channels that have changed for certain, with what."""
    each = enumerate(health.channels())
    parts = [(i, what, one) for i, found in each for what, one in (("gain", found.gain), ("zero", found.zero))]
    return [(i, what) for i, what, one in parts if one is not None and one.changed]


def after(drawn: SuccessiveContacts, baseline: int, *later: Sequence[BestSample]) -> Health:
    health = Health(drawn.metadata)
    health.add(drawn.contacts(baseline))
    for samples in later:
        health.add(samples)
    return health


def test_an_honest_surface_has_not_changed_and_the_intervals_hold_that(drawn: SuccessiveContacts) -> None:
    held = []
    for seed in range(4):
        drawn.begin(seed)
        health = Health(drawn.metadata)
        for _ in range(4):
            health.add(drawn.contacts(25))
            assert changed(health) == []
        for one in health.channels():
            assert (one.contacts, one.since_us) == (100, 0)
            assert one.zero is not None
            held += [one.gain.low < 0 < one.gain.high, one.zero.low < 0 < one.zero.high]
    assert np.mean(held) > 0.8


@pytest.mark.parametrize(
    ("channel", "fall", "readings", "within"),
    [(0, 0.04, 45, 3), (3, 0.04, 45, 3), (1, 0.01, None, 20), (2, 0.01, None, 20)],
)
def test_a_gain_that_falls_is_named_within_few_contacts(
    drawn: SuccessiveContacts, channel: int, fall: float, readings: int | None, within: int
) -> None:
    """4 % of an outer channel within three rested contacts, 1 % of an inner one within twenty."""
    named, held = 0, []
    for seed in range(5):
        drawn.begin(20 + seed, readings)
        health = after(drawn, BASELINE)
        drawn.gain[channel] *= 1 - fall
        begin_us = drawn.at_us
        health.add(drawn.contacts(within))
        named += changed(health) == [(channel, "gain")]
        one = health.channels()[channel]
        held.append(one.gain.low < -fall < one.gain.high)
        if fall == 0.04:
            health.add(drawn.contacts(9))
            assert changed(health) == [(channel, "gain")]
            one = health.channels()[channel]
            assert one.since_us == pytest.approx(begin_us, abs=3 * drawn.every_us)
            assert one.gain.value == pytest.approx(-0.04, abs=0.012)
    assert named >= 4
    assert sum(held) >= 4


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    "a gain has changed only if it deviates from the model by more than the model's floor explains.",
)
@pytest.mark.parametrize(("floors", "named"), [(1.0, []), (15.0, [(1, "gain")])])
def test_a_gain_that_was_off_from_the_start_on_has_changed_only_beyond_the_floor(
    drawn: SuccessiveContacts, floors: float, named: list[tuple[int, str]]
) -> None:
    drawn.begin(50)
    drawn.gain[1] *= 1 - floors * drawn.metadata.floor.gain[1]
    assert changed(after(drawn, 20)) == named


@pytest.mark.promise("docs/reference/sensor-health.md", "A common change of all gains looks like force.")
def test_a_common_change_is_force_and_is_not_claimed_to_be_seen(drawn: SuccessiveContacts) -> None:
    drawn.begin(2)
    health = after(drawn, BASELINE)
    drawn.gain *= 0.9
    health.add(drawn.contacts(60))
    assert changed(health) == []


@pytest.mark.promise("docs/reference/sensor-health.md", "A zero is compared at rest, so no gain can imitate it.")
def test_a_zero_that_creeps_is_no_gain(drawn: SuccessiveContacts) -> None:
    drawn.begin(4)
    health = after(drawn, BASELINE)
    for _ in range(40):
        drawn.zero_mm[1] += 0.0003
        health.add(drawn.contacts(1))
    assert changed(health) == [(1, "zero")]
    health.add(drawn.contacts(8))
    zero = health.channels()[1].zero
    assert zero is not None
    assert zero.low < 0.012 < zero.high


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    "A change within four times the drift that the scene states is no change.",
)
def test_a_zero_that_drifts_within_what_the_scene_states_has_not_changed(drawn: SuccessiveContacts) -> None:
    drawn.begin(8)
    health = after(drawn, BASELINE)
    for _ in range(30):
        drawn.zero_mm[1] += 0.1 * drawn.metadata.floor.zero_mm[1]
        health.add(drawn.contacts(1))
    health.add(drawn.contacts(20))
    assert changed(health) == []


@pytest.mark.promise("docs/reference/sensor-health.md", "Changes one after the other are told apart.")
def test_two_channels_that_change_one_after_the_other_are_both_named(drawn: SuccessiveContacts) -> None:
    drawn.begin(5)
    health = after(drawn, BASELINE)
    drawn.gain[1] *= 0.95
    health.add(drawn.contacts(60))
    drawn.gain[3] *= 1.04
    health.add(drawn.contacts(60))
    assert changed(health) == [(1, "gain"), (3, "gain")]
    drawn.gain[1] /= 0.95
    health.add(drawn.contacts(60))
    assert changed(health) == [(3, "gain")]


def test_a_workpiece_on_two_feet_leaves_the_intervals_of_the_gains_true(drawn: SuccessiveContacts) -> None:
    """Its contacts are always alike: together they would say much, and neither one load nor one channel explains it."""
    held = []
    for seed in range(4):
        drawn.begin(100 + seed)
        health = after(drawn, BASELINE)
        for _ in range(4):
            health.add(drawn.contacts(4, at_mm=(100.0, 300.0)))
            health.add(drawn.contacts(12))
        assert changed(health) == []
        held += [one.gain.low < 0 < one.gain.high for one in health.channels()]
    assert np.mean(held) > 0.85


def test_a_history_is_read_again_as_it_was(drawn: SuccessiveContacts) -> None:
    drawn.begin(7)
    health = after(drawn, BASELINE)
    drawn.gain[2] *= 0.96
    health.add(drawn.contacts(30))
    again = Health(drawn.metadata, json.loads(json.dumps(health.to_json())))
    assert again.channels() == health.channels()
    assert changed(again) == [(2, "gain")]
    with pytest.raises(ValueError, match="another layout"):
        Health(drawn.metadata.model_copy(update={"layout": drawn.metadata.layout[:3]}), health.to_json())


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    "With more than two sensors, each contact checks their gains against each other.",
)
@pytest.mark.parametrize("channels", [1, 2])
def test_two_channels_or_fewer_show_no_gain(bench: ModelFile, channels: int) -> None:
    said, table = bench.metadata, bench.metadata.influence
    floor = said.floor.model_copy(update={"gain": [0.003] * channels, "zero_mm": [0.001] * channels})
    rows = [row[:channels] for row in table.mm_per_n]
    few = said.model_copy(
        update={
            "layout": said.layout[:channels], "floor": floor, "influence": table.model_copy(update={"mm_per_n": rows})
        }
    )  # fmt: skip
    health = Health(few)
    random = np.random.default_rng(1)
    for at_us in range(40):
        values = np.array(rows[random.integers(len(rows))]) * random.uniform(2, 20)
        health.add([BestSample(at_us, values.tolist(), [0.002] * channels, [0.0] * channels, [0.001] * channels)])
    assert changed(health) == []
    for one in health.channels():
        assert one.gain.low < -0.5
        assert one.gain.high > 0.5


def test_more_channels_need_more_evidence() -> None:
    """Among many channels, the largest likelihood ratio is larger by chance."""

    def is_named(channels: int, gain: float) -> bool:
        history, information, none = History(channels), np.zeros((channels, channels)), np.zeros(channels)
        information[0, 0] = 1e4
        for number in range(40):
            score = information[0] * (gain if number >= 20 else 0.0)
            history.add(Block(number, 1, information, score, none, none), set())
        return bool(find_changes(history, np.full(channels, 1e-3)))

    least = next(gain for gain in np.linspace(0.001, 0.1, 5000) if is_named(4, gain))
    assert not is_named(8, least)
    assert is_named(8, 1.05 * least)
