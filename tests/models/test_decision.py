"""The state of a surface from consecutive samples: touch, lift, ringing, and what no single contact explains."""

from collections.abc import Iterable

import numpy as np
import pytest
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime import (
    Answers,
    Evidence,
    Hypotheses,
    Memory,
    ModelFile,
    State,
    Suspects,
    Weighed,
    evidence,
    is_odd,
    is_unchecked,
    memories_after,
)
from support.surfaces.deflections import deflections_of

CLEAR, CONTACT, UNEXPLAINED = "clear", "contact", "unexplained"


AT_REST = Memory(State.CLEAR, armed=True)


class World:
    """Deflections of the bench, and what a decider makes of samples of them."""

    def __init__(self, model: ModelFile) -> None:
        self.model, self.metadata = model, model.metadata
        self.rng = np.random.default_rng(1)
        self.channels = len(model.channels)
        self.decider = Hypotheses(model.metadata.thresholds, [AT_REST])

    def run(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        return self.model.run(deflection_mm, whitening_per_mm)

    def load(self, *loads: tuple[float, float]) -> Floats:
        """Deflection (channels,) under loads of (position_mm, force_n)."""
        found: Floats = deflections_of(self.model, *np.array(loads).T).sum(axis=0)
        return found

    def sample(
        self,
        deflection_mm: Floats,
        scatter_mm: Iterable[Floats] = (),
        valid: Iterable[bool] = (),
        noisier: float = 1.0,
    ) -> Weighed:
        """One sample with some times the noise of a settled one; `scatter_mm`: along which its readings scatter."""
        noise_mm2 = np.full((1, self.channels), (noisier * self.metadata.noise.sample_mm) ** 2)
        covariance_mm2 = np.diag(noise_mm2[0]) + sum((np.outer(one, one) for one in scatter_mm), np.zeros(()))
        working = np.array([list(valid) or [True] * self.channels])
        noisy = deflection_mm + self.rng.normal(scale=self.metadata.noise.sample_mm, size=self.channels)
        return Weighed(np.where(working, noisy, 0.0), covariance_mm2[None], noise_mm2, working)

    def step(self, deflection_mm: Floats, *scatter_mm: Floats, lost: Iterable[int] = (), noisier: float = 1.0) -> str:
        """Decide on a sample without the channels that are lost; an unsteady one has a mark."""
        valid = [channel not in lost for channel in range(self.channels)]
        (said,) = evidence(self.metadata, self.run, self.sample(deflection_mm, scatter_mm, valid, noisier))
        verdict = self.decider.step(said)
        return verdict.state.value + "*" * verdict.unsteady


def named_after(suspects: Suspects, sample: Weighed) -> str | None:
    """Name the channel that contradicts the others, after one more sample."""
    suspects.add(*suspects.leave_out(sample))
    return suspects.suspect


@pytest.fixture
def world(bench: ModelFile) -> World:
    return World(bench)


SEQUENCES = {
    "a still load is a contact until it is gone": "rest: clear; load: contact; load: contact; rest: clear",
    # A window that mixes rest and load scatters along the deflection of the load, as far as it goes.
    "a touch is seen at its first reading, and a large covariance ends no contact": (
        "rest: clear; 0.05 load ~ load: contact*; 0.3 load ~ load: contact*; 0.6 load ~ load: contact*; load: contact;"
        "-0.3 load ~ load: contact*; rest ~ load: contact*"
    ),
    "a lift shows as soon as the sample could show the load": "load: contact; rest ~ 0.02 load: clear*",
    # Once it has lain still, it is touched by the same deflection.
    "a beam that rings after a lift is not touched by that": (
        "load: contact; rest ~ 0.05 load: clear*; 0.08 load ~ 0.05 load: clear*; -0.08 load ~ 0.05 load: clear*;"
        "0.05 load ~ 0.05 load: clear*; rest: clear x5; 0.05 load: contact"
    ),
    "a beam that rings after a lift can be touched": (
        "load: contact; rest ~ 0.02 load: clear*; load ~ 0.02 load: contact*"
    ),
    # A crest that looks still is a swing, and a load that stays is a contact.
    "one still sample is no rest while a beam rings after a lift": (
        "load: contact; rest ~ 0.05 load: clear*; rest: clear; 0.08 load ~ 0.05 load: clear*; 0.025 load: clear*;"
        "rest ~ 0.025 load: clear*; 0.025 load: clear* x2; 0.025 load: contact"
    ),
    # Each swing lies within the covariance, and alone it could be a lift.
    "a beam that rings about a load is not lifted by one swing": (
        "load: contact; 0.6 mode ~ mode: contact*; load + 0.2 mode ~ mode: contact*; 0.6 mode ~ mode: contact* x2;"
        "0.6 mode ~ mode: clear*"
    ),
    "two contacts": "rest: clear; two: clear* x2; two: unexplained x8; rest: unexplained x2; rest: clear x2",
    "a pull": "rest: clear; pull: clear* x2; pull: unexplained x2; rest: unexplained x2; rest: clear x2",
    "a wedge under s3": "rest: clear; wedge: clear* x2; wedge: unexplained x2; rest: unexplained x2; rest: clear x2",
    "s2 is stuck": "rest: clear; stuck: clear* x2; stuck: unexplained x2; rest: unexplained x2; rest: clear x2",
    "a contact that becomes two is doubted at once and comes back": (
        "load: contact; two: contact* x2; two: unexplained x2; load: unexplained x2; load: contact"
    ),
    "a large covariance explains nothing away": (
        "rest: clear; two: clear* x2; two: unexplained; two ~ each: unexplained* x5"
    ),
    "a single odd sample changes no state": "wedge: clear*; rest: clear; wedge: clear*",
    "a stretch ends when the odd channel drops out": (
        "wedge: clear* x2; wedge: unexplained x3; rest without s3: unexplained x2; rest without s3: clear;"
        "load without s3: contact; wedge: contact* x2; wedge: unexplained;"
        "load ~ 0.02 load without s3: unexplained* x2; load ~ 0.02 load without s3: contact*"
    ),
    # As after a start, when a mean holds fewer readings than the model was made for.
    "a lift that only means of few readings show takes three": (
        "load: contact; rest of few: contact* x2; rest of few: clear"
    ),
}
"""Each step: the deflection, ~ along which the readings scatter, and the state; * if it is unsteady."""


@pytest.mark.promise(
    "docs/reference/contact.md",
    (
        "until five still samples in a row have shown the beam at rest, a touch needs four times the log odds, or "
        "three samples in a row above the threshold."
    ),
    "so a touch of a ringing beam may be seen two samples late",
    "means of few readings, and samples that pass for rest only because they are so uncertain, take three in a row.",
    (
        "`unexplained` begins after three samples in a row that neither rest nor a single contact explains, and ends "
        "after three that one of them explains. Until then the state stays, with `unsteady`."
    ),
)
@pytest.mark.parametrize("sequence", SEQUENCES.values(), ids=SEQUENCES)
def test_the_state_follows(world: World, sequence: str) -> None:
    two, load = world.load((100, 8), (300, 8)), world.load((100, 8))
    shapes = {
        "rest": 0 * load,
        "load": load,
        "mode": world.load((200, 5)),
        "two": two,
        "pull": world.load((200, -0.5)),
        "wedge": 0.5 * np.eye(world.channels)[2],
        "stuck": load * (np.arange(world.channels) != 1),
    }

    def deflection(text: str) -> Floats:
        terms = [term.split() for term in text.split(" + ")]
        total: Floats = sum((float((["1", *term])[-2]) * shapes[term[-1]] for term in terms), 0 * load)
        return total

    for step in sequence.split(";"):
        what, _, expected = step.strip().partition(": ")
        state, _, times = expected.partition(" x")
        what, lost = what.removesuffix(" without s3"), [2] * what.endswith("without s3")
        what, noisier = what.removesuffix(" of few"), 2.0 if what.endswith(" of few") else 1.0
        where, *along = what.split(" ~ ")
        scatter = list(np.diag(two)) if along == ["each"] else [deflection(one) for one in along]
        for _ in range(int(times or 1)):
            assert world.step(deflection(where), *scatter, lost=lost, noisier=noisier) == state, step


def test_honest_contacts_and_rest_stay_explained(world: World) -> None:
    low, high = world.metadata.ranges.force_n
    for _ in range(100):
        load = world.load((world.rng.uniform(5, 395), world.rng.uniform(low, high)))
        assert [world.step(load) for _ in range(2)] == [CONTACT] * 2
        # At rest, most samples lie below the threshold of a lift, not all.
        assert CLEAR in [world.step(0 * load) for _ in range(12)]


@pytest.mark.promise(
    "docs/reference/contact.md",
    "It appears when nearly all of the last unexplained samples name the same channel.",
)
def test_the_channel_that_contradicts_the_others_is_named_after_many_samples(world: World) -> None:
    suspects = Suspects(world.metadata, world.run)
    wedge = 0.5 * np.eye(world.channels)[2]
    named = [named_after(suspects, world.sample(wedge)) for _ in range(60)]
    assert named[:30] == [None] * 30
    assert named[-1] == world.model.channels[2]
    suspects.clear()
    assert named_after(suspects, world.sample(wedge)) is None


def test_two_contacts_are_not_taken_for_a_broken_channel(world: World) -> None:
    for far in (250, 350):
        suspects = Suspects(world.metadata, world.run)
        two = world.load((100, 8), (far, 8))
        assert [named_after(suspects, world.sample(two)) for _ in range(60)] == [None] * 60


@pytest.mark.promise(
    "docs/reference/contact.md",
    "Only one or two channels work, so nothing would notice a second load or a wrong sensor.",
)
def test_two_channels_take_two_contacts_for_one_but_not_a_pull(world: World) -> None:
    valid = [True, False, False, True, *[False] * (world.channels - 4)]

    def states(deflection: Floats) -> list[State]:
        decider = Hypotheses(world.metadata.thresholds, [AT_REST])
        (said,) = evidence(world.metadata, world.run, world.sample(deflection, valid=valid))
        assert is_unchecked(world.metadata, said)
        return [decider.step(said).state for _ in range(5)]

    assert states(world.load((100, 8), (300, 8))) == [State.CONTACT] * 5
    # A pull, and a wedge that lifts one sensor while a contact presses the other.
    wedge = np.where(np.arange(world.channels) == 3, -0.3, 1.0) * world.load((100, 8))
    for odd in (world.load((200, -0.5)), wedge):
        assert states(odd) == [State.CLEAR] * 2 + [State.UNEXPLAINED] * 3


def test_a_contact_ends_although_the_channels_that_saw_it_are_lost(world: World) -> None:
    for at_mm in (5, 100, 395):
        load = world.load((at_mm, 2))
        for lost in ([0], [2], [0, 1], [1, 2], [1, 3]):
            while world.step(load) != CONTACT:
                pass
            # At rest, most samples lie below the threshold of a lift, not all. A contact that is held is doubted.
            states = [world.step(0 * load, lost=lost) for _ in range(20)]
            assert CLEAR in states
            assert CONTACT not in states


def test_a_contact_that_weakens_is_doubted(world: World) -> None:
    load = world.load((100, 8))
    world.step(load)
    (said,) = evidence(world.metadata, world.run, world.sample(load))
    # Log odds grow as the square of the deflection: a quarter of those of a touch are held, a hundredth is a lift.
    weak, gone = ((world.metadata.thresholds.touch[-1] / said.log_odds * part) ** 0.5 for part in (0.25, 0.01))
    assert [world.step(part * load) for part in (weak, weak, 1, gone)] == [CONTACT + "*"] * 2 + [CONTACT, CLEAR]


@pytest.mark.parametrize("lost", [[2, 3], [0, 2], [1, 2, 3]])
def test_a_pull_is_unexplained_with_any_number_of_channels(world: World, lost: list[int]) -> None:
    pull = world.load((200, -1))
    world.step(0 * pull)
    assert [world.step(pull, lost=lost) for _ in range(4)] == [CLEAR + "*"] * 2 + [UNEXPLAINED] * 2
    assert [world.step(0 * pull, lost=lost) for _ in range(3)] == [UNEXPLAINED] * 2 + [CLEAR]


@pytest.mark.parametrize("lost", [[2, 3], [0, 1], [1, 2, 3]])
def test_no_single_contact_of_any_force_is_unexplained_on_few_channels(world: World, lost: list[int]) -> None:
    for at_mm in (10, 200, 330):
        for force_n in np.geomspace(0.05, 20, 9):
            load = world.load((at_mm, force_n))
            assert UNEXPLAINED not in {world.step(load, lost=lost).rstrip("*") for _ in range(6)}


@pytest.mark.promise("docs/reference/contact.md", "one unexplained sample is `unexplained` at once")
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


def test_a_sample_that_rest_explains_is_not_unexplained(bench: ModelFile) -> None:
    still, weights = np.zeros(4), np.eye(4)
    said = Evidence(still, weights, {"contact_log_odds": -1.0, "misfit": 1e6}, 4, 0.1, False, -1.0, weights, True)
    assert not is_odd(bench.metadata.thresholds, said)
    assert is_odd(bench.metadata.thresholds, said._replace(rest_misfit=1e6))


def test_a_load_that_two_channels_saw_is_not_lifted_by_swings_that_all_of_them_see(world: World) -> None:
    """A swing overloads the inner sensors: what was seen meanwhile says nothing of them."""
    load = world.load((200.0, 10.0))
    assert world.step(load, lost=(1, 2)) == "contact"
    assert [world.step(0.1 * load, load) for _ in range(6)] == ["contact*"] * 6
    assert [world.step(0.0 * load, 0.02 * load) for _ in range(3)][-1] == "clear*"
