"""How samples of a contact become stays of its load, and stays its figures, at the bounds between them."""

from typing import NamedTuple, TypedDict, Unpack

import pytest

from beamtouch_common.outline import Span
from beamtouch_service.record.events.load import MAX_STAYS, Load, Sighting, Stay

STEP_US = 5000


def span(middle: float, half: float = 1.0) -> Span:
    return Span(middle, middle - half, middle + half)


class Known(TypedDict, total=False):
    """What a sample knows of the load; of one reading that shows it unless stated otherwise."""

    begin_us: float
    knows: float
    is_shown: bool
    is_unsteady: bool


class Touched:
    """A load whose samples are 5 ms apart, the first one at the touch."""

    def __init__(self, has_force: bool = True) -> None:
        self.load, self.has_force, self.now_us = Load(0), has_force, -STEP_US

    def see(self, *places_mm: float, force_n: float = 10.0, half: float = 1.0, **more: Unpack[Known]) -> "Touched":
        """Add a sample of each place."""
        for place_mm in places_mm:
            self.now_us += STEP_US
            spans = (span(place_mm, half), span(force_n)) if self.has_force else (span(place_mm, half),)
            begin_us, knows = more.get("begin_us", self.now_us), more.get("knows", 1.0)
            marks = more.get("is_shown", True), more.get("is_unsteady", False)
            self.load.add(Sighting(self.now_us, begin_us, spans, knows, *marks))
        return self

    @property
    def path(self) -> list[tuple[float, ...]]:
        """Begin, length [ms] and place of each stay."""
        return [(since_us / 1e3, lasts_us / 1e3, place_mm) for since_us, lasts_us, _, place_mm, *_ in self.load.path]

    @property
    def position(self) -> Span:
        assert self.load.figures is not None
        return self.load.figures.along[0].mean


def test_samples_whose_intervals_touch_have_a_load_in_common() -> None:
    """Of equal ones, the last tells; its middle is as near to what all have in common as it allows."""
    one = Touched().see(150.0, 152.0)
    assert (one.path, one.position) == ([(0.0, 5.0, 151.0)], (151.0, 151.0, 153.0))
    assert Touched().see(152.0, 150.0).position == (151.0, 149.0, 151.0)
    assert Touched().see(150.0, 152.01).path == [(0.0, 5.0, 150.0), (5.0, 0.0, 152.01)]
    assert len(Touched().see(150.0).see(150.0, force_n=12.01).path) == 2


def test_what_all_samples_have_in_common_becomes_narrower_with_each() -> None:
    """Of the first two, 150 to 151."""
    assert Touched().see(150.0, 151.0).see(148.0, half=2.0, knows=2.0).position == (150.0, 146.0, 150.0)
    assert len(Touched().see(150.0, 151.0).see(149.5, half=0.4).path) == 2


def test_a_sample_beside_what_all_have_in_common_is_explained_by_the_mean_of_all() -> None:
    one = Touched().see(151.9, *[150.0] * 9)  # in common: 150.9 to 151; the mean is near 150
    assert len(one.see(149.6, half=1.2).path) == 1
    assert len(one.see(149.0, half=0.9).path) == 2


def test_the_sample_that_knows_most_has_the_figures() -> None:
    assert Touched().see(150.0, knows=2.0).see(151.0).position == (150.0, 149.0, 151.0)
    assert Touched().see(150.0).see(151.0, half=3.0, knows=2.0).position == (151.0, 148.0, 154.0)
    unsteady = Touched().see(150.0, knows=2.0, is_unsteady=True).see(150.0)
    assert [stay[2] for stay in unsteady.load.path] == [1]
    assert [stay[2] for stay in unsteady.see(150.0, knows=2.0).load.path] == [0]


def test_a_sample_that_does_not_show_the_contact_only_lengthens_its_stay() -> None:
    one = Touched().see(150.0).see(300.0, is_shown=False, knows=9.0)
    assert one.path == [(0.0, 5.0, 150.0)]
    # It counts as long as none shows it.
    assert Touched().see(300.0, 301.0, is_shown=False).path == [(0.0, 5.0, 301.0)]
    assert Touched().see(300.0, is_shown=False).see(150.0, 150.0).path == [(0.0, 10.0, 150.0)]


def test_a_load_changes_with_the_first_reading_that_differs_but_not_before_the_best_sample() -> None:
    before = Touched().see(150.0, knows=2.0).see(150.0, 150.0)
    assert before.see(200.0, begin_us=7000).path == [(0.0, 7.0, 150.0), (7.0, 8.0, 200.0)]
    before = Touched().see(150.0, 150.0, 150.0)
    assert before.see(200.0, begin_us=7000).path == [(0.0, 10.0, 150.0), (10.0, 5.0, 200.0)]


@pytest.mark.parametrize(
    ("at_us", "begin_us", "ends_us"), [(20_000, 12_000, 12_000), (20_000, 3000, 5000), (4000, 3000, 4000)]
)
def test_a_load_ends_with_the_first_clear_reading_but_not_before_its_best_sample(
    at_us: int, begin_us: float, ends_us: int
) -> None:
    one = Touched().see(150.0, 150.0)
    assert one.load.lift(at_us, begin_us) == ends_us
    assert one.path == [(0.0, ends_us / 1e3, 150.0)]
    assert Load(0).lift(at_us, begin_us) == at_us


def test_of_unsteady_samples_beside_another_stay_the_mean_over_time_counts() -> None:
    one = Touched().see(150.0, is_unsteady=True)
    one.now_us += 3 * STEP_US
    one.see(151.0, 250.0, is_unsteady=True)
    assert one.path == [(0.0, 25.0, 151.0), (25.0, 0.0, 250.0)]  # the first sample lasted for no time
    one = Touched()
    one.load = Load(-20_000)
    assert one.see(150.0, 151.0, 151.0, 250.0, is_unsteady=True).load.path[0][3:6] == [150.3333, 149.3333, 151.3333]


def test_an_unsteady_load_that_lay_still_has_the_figures_of_its_best_sample() -> None:
    one = Touched().see(150.0, knows=2.0, is_unsteady=True).see(151.0, is_unsteady=True)
    assert one.position == (150.0, 149.0, 151.0)
    # Its mean is beyond the interval of that.
    one = Touched().see(150.0, knows=2.0, is_unsteady=True).see(151.1, is_unsteady=True, half=1.2)
    assert one.position[0] == pytest.approx(151.1, abs=1e-3)


def figures(*stays: tuple[int, float]) -> list[float | None]:
    """Return mean and largest force of stays of these lengths [us] and forces [N], the least place and that of the
    largest force, each at ten times its force."""
    load, begin_us = Load(0), 0
    for lasts_us, force_n in stays:
        spans = (span(10 * force_n), span(force_n))
        load.add(Sighting(begin_us, begin_us, spans, 1.0, is_shown=True, is_unsteady=False))
        begin_us += lasts_us
    load.lift(begin_us, begin_us)
    found = load.figures
    assert found is not None
    assert found.force is not None
    assert found.largest is not None
    return [round(found.force.middle, 4), found.largest.middle, found.along[0].least_mm, found.along[0].at_largest_mm]


def test_ramps_are_no_part_of_the_load_up_to_a_fifth_of_its_time_at_each_end() -> None:
    assert figures((20, 4.0), (60, 8.0), (20, 4.0)) == [8.0, 8.0, 80.0, 80.0]
    assert figures((21, 4.0), (79, 8.0)) == [7.16, 8.0, 40.0, 80.0]
    assert figures((79, 8.0), (21, 4.0)) == [7.16, 8.0, 40.0, 80.0]
    # Of two that together last longer than that, the outer one.
    assert figures((10, 2.0), (10, 5.0), (80, 8.0)) == [8.0, 8.0, 80.0, 80.0]
    assert figures((10, 2.0), (11, 5.0), (79, 8.0))[2] == 50.0
    assert figures((4, 2.0), (16, 5.0), (80, 8.0)) == [8.0, 8.0, 80.0, 80.0]


def test_a_ramp_is_surely_weaker_than_what_follows() -> None:
    """Its interval ends below the middle of that, here 8 N."""
    assert figures((20, 6.99), (80, 8.0))[0] == 8.0
    assert figures((20, 7.0), (80, 8.0))[0] == 7.8


def test_without_forces_a_ramp_has_an_interval_of_more_than_twice_the_width() -> None:
    inner = Stay(0, 1, is_unsteady=False, spans=(span(1.0, 1.0),))
    assert [inner._replace(spans=(span(1.0, half),)).is_weaker(inner) for half in (2.0, 2.01)] == [False, True]


def test_a_single_sample_counts_as_a_microsecond() -> None:
    assert [Stay(0, lasts_us, is_unsteady=False, spans=()).weight for lasts_us in (0, 1, 2)] == [1, 1, 2]
    one = Touched().see(150.0, is_unsteady=True)
    one.now_us -= STEP_US
    assert one.see(151.0, 250.0, is_unsteady=True).path[0] == (0.0, 5.0, 150.5)


def test_a_load_of_which_all_is_unsteady_says_so() -> None:
    assert Touched().load.figures is None
    for marks, is_unsteady in (((True, True), True), ((True, False), False)):
        one = Touched()
        for place_mm, mark in zip((150.0, 250.0), marks, strict=True):
            one.see(place_mm, is_unsteady=mark)
        assert one.load.figures is not None
        assert one.load.figures.is_unsteady is is_unsteady


def test_a_model_without_forces_gives_places_alone() -> None:
    found = Touched(has_force=False).see(150.0, 250.0, 250.0).load.figures
    assert found is not None
    assert (found.force, found.largest, found.along[0].at_largest_mm) == (None, None, None)
    assert (found.along[0].least_mm, found.along[0].most_mm) == (150.0, 250.0)
    with_force = Touched().see(150.0, force_n=5.0).see(250.0, force_n=5.5).load.figures
    assert with_force is not None
    assert (with_force.largest, with_force.along[0].at_largest_mm) == (span(5.5), 250.0)


def test_the_largest_force_is_where_it_was_first() -> None:
    found = Touched().see(150.0, 250.0, 250.0).load.figures
    assert found is not None
    assert found.along[0].at_largest_mm == 150.0


def test_a_path_of_too_many_stays_joins_the_two_neighbours_that_lasted_least() -> None:
    """But none of those that are farthest left or right, or press hardest."""
    one = Touched()
    for number in range(MAX_STAYS + 1):
        one.see(150.0 + 10 * (number % 2), force_n=20.0 if number == 12 else 10.0)
        one.now_us += 10 * STEP_US * (number not in {5, 6, 7})
    path = one.path
    assert len(path) == MAX_STAYS == 25
    assert (6, 7) not in [(round(stay[0]), round(stay[1])) for stay in path]
    shortest = [stay for stay in path if stay[2] not in {150.0, 160.0}]
    assert shortest == [(275.0, 10.0, 155.0)]


class Part(NamedTuple):
    """A part of a contact that lasts for so many samples; those around it are elsewhere."""

    samples: int
    place_mm: float = 0.0
    force_n: float = 10.0
    is_unsteady: bool = False


def joined(parts: dict[int, Part]) -> list[list[float]]:
    """Return the stays of a path of one stay too many that are two of these; the others last for 50 samples."""
    one = Touched()
    for number in range(MAX_STAYS + 1):
        part = parts.get(number, Part(50))
        place_mm = part.place_mm or 150.0 + 10 * (number % 2)
        one.see(*[place_mm] * part.samples, force_n=part.force_n, is_unsteady=part.is_unsteady)
    whole = {150.0, 160.0, *(part.place_mm for part in parts.values())}
    return [stay for stay in one.load.path if stay[3] not in whole]


EXTREMES = {0: Part(50, 100.0, force_n=20.0), 1: Part(50, 300.0)}
"""These are farthest left and right, and no ramps."""


@pytest.mark.parametrize("first", [2, MAX_STAYS - 2])
def test_of_all_pairs_the_one_that_lasted_least_together_becomes_one(first: int) -> None:
    """However short one beside a long one is."""
    alone = {10: Part(1), first: Part(20), first + 1: Part(20)}
    (stay,) = joined(EXTREMES | alone)
    assert (stay[1], stay[3]) == (40 * STEP_US, 155.0)


@pytest.mark.parametrize("first", [5, 6])
def test_of_a_steady_stay_and_an_unsteady_one_comes_a_steady_one(first: int) -> None:
    pair = {5: Part(5), 6: Part(5)} | {first: Part(5, is_unsteady=True)}
    assert [stay[2] for stay in joined(EXTREMES | pair)] == [0]
    both = {number: Part(5, is_unsteady=True) for number in (5, 6)}
    assert [stay[2] for stay in joined(EXTREMES | both)] == [1]


def test_a_ramp_is_no_farthest_place() -> None:
    """It may become one with the stay after it."""
    ramp = {0: Part(2, 100.0, force_n=5.0), 1: Part(2, 160.0), 2: Part(50, 120.0, force_n=20.0), 3: Part(50, 300.0)}
    (stay,) = joined(ramp)
    assert (stay[0], stay[3]) == (0, 130.0)


def test_a_load_goes_on_from_its_path_and_memory_as_if_nothing_had_been() -> None:
    whole, first = (Touched().see(350.0, 150.0, 151.0, 250.0) for _ in range(2))
    load = first.load
    first.load = Load.read(0, load.path, load.memory)
    for one in (whole, first):
        one.see(250.5, 151.0, 152.5)
    assert first.load.path == whole.load.path
    assert first.load.figures == whole.load.figures
