"""The state of a surface from consecutive samples: touch, lift, ringing, and what no single contact explains."""

from collections.abc import Callable, Iterable

import numpy as np
import pytest
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats
from beamtouch_models.decision.decider import Decider
from beamtouch_models.modelfile import (
    Answers,
    Hypotheses,
    ModelFile,
    State,
    Suspects,
    Weighed,
    evidence,
    is_odd,
    is_unchecked,
    memories_after,
)
from beamtouch_models.surface import prior_of_model

CLEAR, CONTACT, UNEXPLAINED = "clear", "contact", "unexplained"


class World:
    """Deflections of the bench, and what a decider makes of samples of them."""

    def __init__(self, model: ModelFile) -> None:
        self.model, self.metadata = model, model.metadata
        self.table = prior_of_model(model.metadata).table
        self.rng = np.random.default_rng(1)
        self.channels = len(model.channels)
        self.decider: Decider | Hypotheses = Decider(model.metadata.thresholds)

    def run(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        return self.model.estimate(deflection_mm.astype(np.float32), whitening_per_mm.astype(np.float32))

    def load(self, *loads: tuple[float, float]) -> Floats:
        """Deflection (channels,) under loads of (position_mm, force_n)."""
        found: Floats = sum(
            (force_n * self.table(np.array([at_mm]))[0] for at_mm, force_n in loads), np.zeros(self.channels)
        )
        return found

    def sample(self, deflection_mm: Floats, scatter_mm: Iterable[Floats] = (), valid: Iterable[bool] = ()) -> Weighed:
        """One settled sample with noise; `scatter_mm`: the vectors along which its readings scatter."""
        noise_mm2 = np.full((1, self.channels), self.metadata.noise.sample_mm**2)
        covariance_mm2 = np.diag(noise_mm2[0]) + sum((np.outer(one, one) for one in scatter_mm), np.zeros(()))
        working = np.array([list(valid) or [True] * self.channels])
        noisy = deflection_mm + self.rng.normal(scale=self.metadata.noise.sample_mm, size=self.channels)
        return Weighed(np.where(working, noisy, 0.0), covariance_mm2[None], noise_mm2, working)

    def step(self, deflection_mm: Floats, *scatter_mm: Floats, lost: Iterable[int] = ()) -> str:
        """Decide on a sample without the channels that are lost; an unsteady one has a mark."""
        valid = [channel not in lost for channel in range(self.channels)]
        (said,) = evidence(self.metadata, self.run, self.sample(deflection_mm, scatter_mm, valid))
        verdict = self.decider.step(said)
        return verdict.state.value + "*" * verdict.unsteady


def named_after(suspects: Suspects, sample: Weighed) -> str | None:
    """Name the channel that contradicts the others, after one more sample."""
    suspects.add(*suspects.leave_out([sample]))
    return suspects.suspect


@pytest.fixture
def world(bench: ModelFile) -> World:
    return World(bench)


def test_a_still_load_is_a_contact_until_it_is_gone(world: World) -> None:
    load = world.load((100, 8))
    assert [world.step(one) for one in (0 * load, load, load, 0 * load)] == [CLEAR, CONTACT, CONTACT, CLEAR]


def test_a_touch_is_seen_at_its_first_reading_and_is_unsteady(world: World) -> None:
    load = world.load((100, 8))
    world.step(0 * load)
    # A window that mixes rest and load scatters along the deflection of the load, as far as it goes.
    assert [world.step(part * load, load) for part in (0.05, 0.3, 0.6)] == [CONTACT + "*"] * 3
    assert world.step(load) == CONTACT


def test_a_large_covariance_ends_no_contact(world: World) -> None:
    load = world.load((100, 8))
    world.step(load)
    assert [world.step(part * load, load) for part in (0.2, -0.3, 0.0)] == [CONTACT + "*"] * 3


def test_a_lift_shows_as_soon_as_the_sample_could_show_the_load(world: World) -> None:
    load = world.load((100, 8))
    world.step(load)
    assert world.step(0 * load, 0.02 * load) == CLEAR + "*"


def test_a_beam_that_rings_after_a_lift_is_not_touched_by_that(world: World) -> None:
    load = world.load((100, 8))
    world.step(load)
    swings = [world.step(part * load, 0.05 * load) for part in (0.0, 0.08, -0.08, 0.05, -0.05)]
    assert swings == [CLEAR + "*"] * 5
    # Once it has lain still, it is touched by the same deflection.
    assert [world.step(0 * load) for _ in range(5)] == [CLEAR] * 5
    assert world.step(0.05 * load) == CONTACT


def test_one_still_sample_is_no_rest_while_a_beam_rings_after_a_lift(world: World) -> None:
    load = world.load((100, 8))
    world.step(load)
    swings = [world.step(part * load, *[0.05 * load] * moves) for part, moves in ((0.0, 1), (0.0, 0), (0.08, 1))]
    assert swings == [CLEAR + "*", CLEAR, CLEAR + "*"]
    # A crest that looks still is a swing, and a load that stays is a contact.
    small = 0.025 * load
    assert [world.step(small), world.step(0 * load, small)] == [CLEAR + "*"] * 2
    assert [world.step(small) for _ in range(3)] == [CLEAR + "*", CLEAR + "*", CONTACT]


def test_a_beam_that_rings_about_a_load_is_not_lifted_by_one_swing(world: World) -> None:
    load = world.load((100, 8))
    world.step(load)
    mode = world.load((200, 5))
    # Each swing lies within the covariance, and alone it could be a lift.
    assert [world.step(0.6 * mode, mode), world.step(load + 0.2 * mode, mode)] == [CONTACT + "*"] * 2
    assert [world.step(0.6 * mode, mode) for _ in range(3)] == [CONTACT + "*"] * 2 + [CLEAR + "*"]


def test_a_beam_that_rings_can_be_touched(world: World) -> None:
    load = world.load((100, 8))
    world.step(load)
    world.step(0 * load, 0.02 * load)
    assert world.step(load, 0.02 * load) == CONTACT + "*"


@pytest.mark.parametrize(
    "act",
    [
        lambda world: world.load((100, 8), (300, 8)),
        lambda world: world.load((200, -0.5)),
        lambda world: 0.5 * np.eye(world.channels)[2],
        lambda world: world.load((100, 8)) * (np.arange(world.channels) != 1),
    ],
    ids=["two contacts", "a pull", "a wedge under s3", "s2 is stuck"],
)
def test_what_is_no_single_contact_is_unexplained_after_three_samples(
    world: World, act: Callable[[World], Floats]
) -> None:
    deflection = act(world)
    world.step(0 * deflection)
    states = [world.step(deflection) for _ in range(10)]
    assert states == [CLEAR + "*"] * 2 + [UNEXPLAINED] * 8
    assert [world.step(0 * deflection) for _ in range(4)] == [UNEXPLAINED] * 2 + [CLEAR] * 2


def test_a_contact_that_becomes_two_is_doubted_at_once_and_comes_back(world: World) -> None:
    one, two = world.load((100, 8)), world.load((100, 8), (300, 8))
    world.step(one)
    assert [world.step(two) for _ in range(4)] == [CONTACT + "*"] * 2 + [UNEXPLAINED] * 2
    assert [world.step(one) for _ in range(3)] == [UNEXPLAINED] * 2 + [CONTACT]


def test_a_large_covariance_explains_nothing_away(world: World) -> None:
    two = world.load((100, 8), (300, 8))
    for _ in range(3):
        world.step(two)
    swings = [np.diag(two)[:, index] for index in range(world.channels)]
    assert [world.step(two, *swings) for _ in range(5)] == [UNEXPLAINED + "*"] * 5


def test_a_single_odd_sample_changes_no_state(world: World) -> None:
    wedge = 0.5 * np.eye(world.channels)[2]
    assert [world.step(wedge), world.step(0 * wedge), world.step(wedge)] == [CLEAR + "*", CLEAR, CLEAR + "*"]


def test_honest_contacts_and_rest_stay_explained(world: World) -> None:
    low, high = world.metadata.ranges.force_n
    for _ in range(300):
        load = world.load((world.rng.uniform(5, 395), world.rng.uniform(low, high)))
        assert [world.step(load) for _ in range(2)] == [CONTACT] * 2
        # At rest, most samples lie below the threshold of a lift, not all.
        assert CLEAR in [world.step(0 * load) for _ in range(12)]


def test_the_channel_that_contradicts_the_others_is_named_after_many_samples(world: World) -> None:
    suspects = Suspects(world.metadata, world.run)
    wedge = 0.5 * np.eye(world.channels)[2]
    named = [named_after(suspects, world.sample(wedge)) for _ in range(60)]
    assert named[:30] == [None] * 30
    assert named[-1] == world.model.channels[2]
    suspects.clear()
    assert named_after(suspects, world.sample(wedge)) is None


def test_two_contacts_are_not_taken_for_a_broken_channel(world: World) -> None:
    for far in (250, 300, 350):
        suspects = Suspects(world.metadata, world.run)
        two = world.load((100, 8), (far, 8))
        assert [named_after(suspects, world.sample(two)) for _ in range(60)] == [None] * 60


def test_two_channels_take_two_contacts_for_one_but_not_a_pull(world: World) -> None:
    valid = [True, False, False, True, *[False] * (world.channels - 4)]

    def states(deflection: Floats) -> list[State]:
        decider = Decider(world.metadata.thresholds)
        (said,) = evidence(world.metadata, world.run, world.sample(deflection, valid=valid))
        assert is_unchecked(said)
        return [decider.step(said).state for _ in range(5)]

    assert states(world.load((100, 8), (300, 8))) == [State.CONTACT] * 5
    # A pull, and a wedge that lifts one sensor while a contact presses the other.
    wedge = np.where(np.arange(world.channels) == 3, -0.3, 1.0) * world.load((100, 8))
    for odd in (world.load((200, -0.5)), wedge):
        assert states(odd) == [State.CLEAR] * 2 + [State.UNEXPLAINED] * 3


def test_a_sample_without_each_channel_shows_which_one_is_wrong(world: World) -> None:
    suspects = Suspects(world.metadata, world.run)
    wedge = world.sample(world.load((100, 8)) + 0.5 * np.eye(world.channels)[2])
    rest = world.sample(world.load((100, 0)))
    without, explained = suspects.leave_out([wedge, rest])

    assert [name for name, left in without.items() if left.explained] == [world.model.channels[2]]
    assert all(left.explained for left in explained.values())
    for channel, (name, left) in enumerate(without.items()):
        (alone,) = evidence(world.metadata, world.run, wedge.without(channel))
        assert name == world.model.channels[channel]
        assert left.misfit == pytest.approx(alone.misfit, rel=1e-3, abs=1e-3)
        assert left.rest_misfit == pytest.approx(alone.rest_misfit)
        assert left.explained != is_odd(world.metadata.thresholds, alone)


def test_too_few_channels_cannot_contradict_and_are_not_left_out(world: World) -> None:
    suspects = Suspects(world.metadata, world.run)
    two = [True, True, *[False] * (world.channels - 2)]
    sample = world.sample(world.load((100, 8), (300, 8)), valid=two)
    assert suspects.leave_out([sample]) == [{}]
    (said,) = evidence(world.metadata, world.run, sample)
    assert not is_odd(world.metadata.thresholds, said)


def test_a_stretch_ends_when_the_odd_channel_drops_out(world: World) -> None:
    wedge = 0.5 * np.eye(world.channels)[2]
    for _ in range(5):
        world.step(wedge)
    rest, load = 0 * wedge, world.load((100, 8))
    assert [world.step(rest, lost=[2]) for _ in range(3)] == [UNEXPLAINED] * 2 + [CLEAR]
    assert world.step(load, lost=[2]) == CONTACT
    # Also while the beam moves, as far as the other channels could show it at all.
    for _ in range(3):
        world.step(wedge)
    assert [world.step(load, 0.02 * load, lost=[2]) for _ in range(3)][-1] == CONTACT + "*"


def test_a_contact_ends_although_the_channels_that_saw_it_are_lost(world: World) -> None:
    for at_mm in (5, 20, 100, 200, 300, 380, 395):
        load = world.load((at_mm, 2))
        for lost in ([0], [1], [2], [3], [0, 1], [0, 2], [1, 2], [1, 3], [2, 3]):
            while world.step(load) != CONTACT:
                pass
            # At rest, most samples lie below the threshold of a lift, not all. A contact that is held is doubted.
            states = [world.step(0 * load, lost=lost) for _ in range(40)]
            assert CLEAR in states
            assert CONTACT not in states


def test_a_contact_that_weakens_is_doubted(world: World) -> None:
    load = world.load((100, 8))
    world.step(load)
    (said,) = evidence(world.metadata, world.run, world.sample(load))
    # Log odds grow as the square of the deflection.
    half = (world.metadata.thresholds.touch[-1] / said.log_odds / 2) ** 0.5
    assert [world.step(part * load) for part in (half, 1)] == [CONTACT + "*", CONTACT]


@pytest.mark.parametrize("lost", [[2, 3], [0, 2], [0, 1], [1, 2], [1, 2, 3], [0, 1, 3]])
def test_a_pull_is_unexplained_with_any_number_of_channels(world: World, lost: list[int]) -> None:
    pull = world.load((200, -1))
    world.step(0 * pull)
    assert [world.step(pull, lost=lost) for _ in range(4)] == [CLEAR + "*"] * 2 + [UNEXPLAINED] * 2
    assert [world.step(0 * pull, lost=lost) for _ in range(3)] == [UNEXPLAINED] * 2 + [CLEAR]


@pytest.mark.parametrize("lost", [[2, 3], [0, 3], [1, 2], [0, 1], [1, 2, 3]])
def test_no_single_contact_of_any_force_is_unexplained_on_few_channels(world: World, lost: list[int]) -> None:
    for at_mm in (10, 100, 200, 330):
        for force_n in np.geomspace(0.05, 20, 25):
            load = world.load((at_mm, force_n))
            assert UNEXPLAINED not in {world.step(load, lost=lost).rstrip("*") for _ in range(6)}


def test_if_no_state_is_known_an_odd_sample_is_unexplained_at_once(world: World) -> None:
    wedge = 0.5 * np.eye(world.channels)[2]
    world.decider = Hypotheses(world.metadata.thresholds, memories_after(None))
    assert [world.step(one) for one in (wedge, wedge, 0 * wedge)] == [UNEXPLAINED] * 3
    world.decider = Hypotheses(world.metadata.thresholds, memories_after(None))
    assert [world.step(one) for one in (0 * wedge, wedge, wedge)] == [CLEAR, CLEAR + "*", CLEAR + "*"]


def test_a_mean_of_many_readings_may_lag_by_less_than_the_noise_of_the_model_and_is_steady(world: World) -> None:
    load = world.load((100, 8))
    settled = world.sample(load)
    noise_mm = world.metadata.noise.sample_mm
    for lag, moves in ((0.5, False), (2.0, True)):
        away = lag * noise_mm * np.ones(world.channels)
        few_mm2 = settled.noise_mm2 / 50
        covariance_mm2 = (np.diag(few_mm2[0]) + np.outer(away, away))[None]
        sample = Weighed(settled.deflection_mm, covariance_mm2, few_mm2, settled.valid)
        (said,) = evidence(world.metadata, world.run, sample)
        assert said.moves is moves
