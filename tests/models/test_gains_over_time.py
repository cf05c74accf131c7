"""Gains and zeros over a history of contacts, against dense linear algebra of all unknowns."""

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime.health.changes import (
    EXACT,
    GAIN_CHANGE,
    NEW,
    Block,
    Change,
    Gains,
    History,
    find_changes,
    zero_of,
)

CHANNELS, BLOCKS = 4, 7
FLOOR = np.array([0.003, 0.011, 0.006, 0.02])


def block(seed: int, first_us: int, contacts: int = 1, scale: float = 3e3) -> Block:
    """Return a contact that says as much of gains and zeros as chance has it."""
    random = np.random.default_rng(seed)
    root = random.standard_normal((2, CHANNELS))
    information = scale * root.T @ root
    return Block(
        first_us,
        contacts,
        information,
        information @ random.normal(0.0, 0.01, CHANNELS),
        random.uniform(1e4, 9e4, CHANNELS),
        random.normal(0.0, 30.0, CHANNELS),
    )


HISTORY = History(CHANNELS, [block(seed, 10 * seed, 2 * seed + 1) for seed in range(BLOCKS)])
CHANGES = [Change(2, 1), Change(4, 3), Change(5, 1)]


def solved(changes: list[Change], floor: Floats = FLOOR) -> tuple[Floats, Floats]:
    """Return all unknowns, the gains of the beginning and the changes, and their covariance."""
    prior = np.concatenate([floor, np.full(len(changes), GAIN_CHANGE)])
    total, score = np.diag(prior**-2.0), np.zeros(len(prior))
    for place, each in enumerate(HISTORY.blocks):
        of_unknowns = np.eye(CHANNELS, len(prior))
        for column, change in enumerate(changes, CHANNELS):
            of_unknowns[change.channel, column] = float(place >= change.block)
        total += of_unknowns.T @ each.information @ of_unknowns
        score += of_unknowns.T @ each.score
    covariance: Floats = np.linalg.inv(total).astype(np.float64)
    return covariance @ score, covariance


@pytest.mark.parametrize("count", range(4))
def test_the_newest_gains_are_those_of_the_beginning_with_all_changes_since(count: int) -> None:
    gains, (means, covariance) = Gains(HISTORY, FLOOR, CHANGES[:count]), solved(CHANGES[:count])
    picked = np.eye(CHANNELS, CHANNELS + count)
    for column, change in enumerate(CHANGES[:count], CHANNELS):
        picked[change.channel, column] = 1.0
    newest, uncertain = gains.now()
    assert newest == pytest.approx(picked @ means, rel=1e-6, abs=1e-12)
    assert uncertain == pytest.approx(picked @ covariance @ picked.T, rel=1e-6, abs=1e-12)
    for channel in range(CHANNELS):
        own = [column for column, change in enumerate(CHANGES[:count], CHANNELS) if change.channel == channel]
        value, deviation = gains.changed(channel)
        assert value == pytest.approx(means[own].sum(), rel=1e-6, abs=1e-12)
        assert deviation == pytest.approx(covariance[np.ix_(own, own)].sum() ** 0.5, rel=1e-6)


@pytest.mark.parametrize("count", range(3))
def test_one_more_change_is_worth_what_the_fit_with_it_says(count: int) -> None:
    candidates = Gains(HISTORY, FLOOR, CHANGES[:count]).candidates()
    for place in range(BLOCKS):
        for channel in range(CHANNELS):
            means, covariance = solved([*CHANGES[:count], Change(place, channel)])
            at = place, channel
            assert candidates.gain[at] == pytest.approx(means[-1], rel=1e-5)
            assert candidates.information[at] == pytest.approx(1 / covariance[-1, -1], rel=1e-5)
            assert candidates.ratio[at] == pytest.approx(means[-1] ** 2 / covariance[-1, -1], rel=1e-5)


def test_without_contacts_the_floor_is_all_that_is_known_and_none_is_exact() -> None:
    newest, uncertain = Gains(History(2), np.array([0.02, 0.0]), []).now()
    assert newest.tolist() == [0.0, 0.0]
    assert uncertain == pytest.approx(np.diag([0.02**2, EXACT**2]))
    assert find_changes(History(2), np.array([0.02, 0.0])) == []


def told(gain: Floats, contacts: int) -> History:
    """Return a history of contacts that say each gain by itself, to 1 %: 0 at first, and these for the newest ones."""
    information = np.eye(len(gain)) * 1e4
    nothing = np.zeros(len(gain))
    return History(
        len(gain),
        [
            Block(
                number, 1, information, information @ (gain if number >= 40 - contacts else nothing), nothing, nothing
            )
            for number in range(40)
        ],
    )


@pytest.mark.parametrize(
    ("gains", "contacts", "named"),
    [
        # With a floor of 2 %, as of a quarter of a contact, the ratio is nearly g^2 1e4 (4 - 4^2 / 40.25).
        ((0.0, 0.02741, 0.0, 0.0), 4, [(36, 1)]),  # 27.06
        ((0.0, 0.02734, 0.0, 0.0), 4, []),  # 26.92
        ((0.0, -0.028, 0.0, 0.0), 4, [(36, 1)]),
        ((0.0, 0.2, 0.0, 0.0), 3, [(37, 1)]),
        ((0.0, 0.2, 0.0, 0.0), 2, []),
        # Another channel explains the contacts nearly as well: 38.5, beside 31 or less.
        ((0.0, 0.0327, 0.0, 0.0293), 4, [(36, 1), (36, 3)]),
        ((0.0, 0.0327, 0.0, 0.0305), 4, []),
        # Of eight channels one is the more often wrong by chance: twice the logarithm of 2 more.
        ((0.0, 0.0279) + 6 * (0.0,), 4, []),
        ((0.0, 0.0288) + 6 * (0.0,), 4, [(36, 1)]),
    ],
)
def test_a_change_is_named_if_it_is_certain_and_no_other_is_as_likely(
    gains: tuple[float, ...], contacts: int, named: list[tuple[int, int]]
) -> None:
    floor = np.full(len(gains), 0.02)
    found = find_changes(told(np.array(gains), contacts), floor)
    assert [(change.block, change.channel) for change in found] == named


def test_a_change_below_the_floor_is_none() -> None:
    for floor, named in ((0.19, 1), (0.21, 0)):
        assert len(find_changes(told(np.array([0.0, 0.2, 0.0, 0.0]), 20), np.full(4, floor))) == named


def test_a_history_keeps_new_contacts_apart_and_sums_up_old_ones() -> None:
    order = np.random.default_rng(5).permutation(400)
    history, boundaries = History(CHANNELS), {110, 2500}
    for number in order.tolist():
        history.add(block(number, 10 * number), boundaries)
    blocks = history.blocks
    assert history.contacts == sum(each.contacts for each in blocks) == 400
    assert [each.first_us for each in blocks] == sorted(each.first_us for each in blocks)
    assert all(each.contacts == 1 for each in blocks[-NEW:])
    assert boundaries <= {each.first_us for each in blocks}
    after = history.after()
    assert after.tolist() == [sum(each.contacts for each in blocks[place:]) for place in range(len(blocks))]
    for each, later in zip(blocks[:-1], after[1:], strict=True):
        assert each.contacts == 1 or each.contacts * 8 <= later
    assert len(blocks) < NEW + 50
    for name in ("information", "score", "rest_weight", "rest_sum"):
        whole = sum(getattr(block(number, 0), name) for number in range(400))
        assert history.since(name)[0] == pytest.approx(whole)
        assert history.since(name)[-1] == pytest.approx(getattr(blocks[-1], name))
    again = History.from_json(CHANNELS, history.to_json())
    assert again.to_json() == history.to_json()
    with pytest.raises(ValueError, match="the history is that of another layout"):
        History.from_json(CHANNELS + 1, history.to_json())


def rested(*zeros_mm: float, first: int = 0) -> History:
    """Return contacts, each after a rest that shows a zero with a weight of 1e6 and more; of `first` none was seen."""
    blocks = []
    for number, zero_mm in enumerate(zeros_mm):
        weight = np.array([0.0 if number < first else 1e6 + 1e5 * number])
        blocks.append(Block(number, 1, np.zeros((1, 1)), np.zeros(1), weight, weight * zero_mm))
    return History(1, blocks)


WEIGHTS = 1e6 + 1e5 * np.arange(40)
DRIFT_MM = 0.002
"""Standard deviation of a zero after a tare."""


def mean_and_weight(begin: int, end: int, zeros_mm: Floats, before: float = 0.0) -> tuple[float, float]:
    weight = WEIGHTS[begin:end]
    return float(weight @ zeros_mm[begin:end]) / (weight.sum() + before), float(weight.sum()) + before


@pytest.mark.parametrize("moved_mm", [0.02, -0.02])
def test_a_zero_that_moved_is_compared_with_the_first_half_of_what_was_before(moved_mm: float) -> None:
    zeros_mm = np.where(np.arange(40) < 25, 0.001, 0.001 + moved_mm)
    found = zero_of(rested(*zeros_mm), 0, DRIFT_MM)
    assert found is not None
    estimate, place = found
    assert place == 25
    assert estimate.changed
    # The first half of the 25 before; the newest eight.
    before, weight = mean_and_weight(0, 12, zeros_mm, DRIFT_MM**-2)
    now, newest = mean_and_weight(32, 40, zeros_mm)
    deviation = (1 / weight + 1 / newest) ** 0.5
    assert estimate.value == pytest.approx(now - before, rel=1e-9)
    assert estimate.high - estimate.value == pytest.approx(1.96 * deviation, rel=1e-4)
    assert estimate.value - estimate.low == pytest.approx(1.96 * deviation, rel=1e-4)


def test_a_zero_that_has_not_moved_is_compared_with_the_older_half() -> None:
    zeros_mm = np.random.default_rng(1).normal(0.0, 0.001, 40)
    found = zero_of(rested(*zeros_mm), 0, DRIFT_MM)
    assert found is not None
    estimate, place = found
    assert (place, estimate.changed) == (20, False)
    before, weight = mean_and_weight(0, 20, zeros_mm, DRIFT_MM**-2)
    now, newest = mean_and_weight(32, 40, zeros_mm)
    assert estimate.value == pytest.approx(now - before, rel=1e-9)
    assert estimate.high - estimate.low == pytest.approx(2 * 1.96 * (1 / weight + 1 / newest) ** 0.5, rel=1e-4)


@pytest.mark.parametrize(("beyond", "changed"), [(5.2, False), (5.4, True)])
def test_a_zero_has_changed_if_it_moved_by_more_than_drift_and_noise_explain(beyond: float, changed: bool) -> None:
    """28 is the square of 5.3 deviations, beyond four times the drift."""
    _, weight = mean_and_weight(0, 12, np.zeros(40), DRIFT_MM**-2)
    _, newest = mean_and_weight(32, 40, np.zeros(40))
    moved_mm = 4 * DRIFT_MM + beyond * (1 / weight + 1 / newest) ** 0.5
    found = zero_of(rested(*np.where(np.arange(40) < 25, 0.0, moved_mm)), 0, DRIFT_MM)
    assert found is not None
    assert found[0].changed is changed


def test_a_zero_is_known_from_rests_only_and_has_changed_since_three_contacts_at_least() -> None:
    assert zero_of(rested(0.1, 0.1, first=2), 0, DRIFT_MM) is None
    for contacts, place in ((2, 37), (3, 37), (4, 36)):
        found = zero_of(rested(*np.where(np.arange(40) < 40 - contacts, 0.0, 0.5)), 0, DRIFT_MM)
        assert found is not None
        assert (found[0].changed, found[1]) == (True, place)
    # Of ten contacts, half are the newest.
    found = zero_of(rested(*0.01 * np.arange(10)), 0, DRIFT_MM)
    assert found is not None
    rising: Floats = 0.01 * np.arange(40, dtype=np.float64)
    newest, _ = mean_and_weight(5, 10, rising)
    assert found[0].changed
    before, _ = mean_and_weight(0, found[1] // 2, rising, DRIFT_MM**-2)
    assert found[0].value == pytest.approx(newest - before)
    # Before the first contact the zero was where the tare put it.
    found = zero_of(rested(0.5, 0.5, 0.5), 0, DRIFT_MM)
    assert found is not None
    assert found[0].value == pytest.approx(0.5)
    assert (found[0].changed, found[1]) == (True, 0)
    exact = zero_of(rested(0.5, 0.5, 0.5), 0, 0.0)
    assert exact is not None
    assert exact[0].changed
