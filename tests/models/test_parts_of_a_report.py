"""Errors and intervals part by part, as the report of a build states them, beside plain loops over the contacts."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import binom

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.drawing import Draws
from beamtouch_models.design.accuracy.limit import Contacts
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.building.report.facts import Part, edges_of, profile_of, regions_of
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

BEAM, PLATE = Extent.of_beam((20.0, 260.0)), Extent(((10.0, 330.0), (50.0, 250.0)))
DRAWS, LIKELY = 160, 6


def contacts_of(extent: Extent, draws: int = DRAWS) -> Contacts:
    """Contacts of unequal weights, some of whose likely places are at the ends of the extent."""
    rng = np.random.default_rng(5)
    likely = extent.at(rng.uniform(-0.02, 1.02, (draws, LIKELY, extent.axes)).clip(0, 1))
    median = np.median(likely, axis=1)
    drawn = Draws(likely[:, 0], rng.uniform(2, 9, draws), np.zeros((draws, 2)), rng.uniform(0.2, 1.8, draws))
    return Contacts(drawn, likely, median, np.zeros(draws))


def answers_to(contacts: Contacts, axes: tuple[str, ...]) -> dict[str, Floats]:
    rng, answers = np.random.default_rng(6), {"force_n": contacts.drawn.force_n - 0.25}
    for axis, median in zip(axes, contacts.median_mm.T, strict=True):
        answers[f"{axis}_mm"] = median + rng.normal(0, 8, len(median))
        answers[f"{axis}_low_mm"] = answers[f"{axis}_mm"] - rng.uniform(20, 60, len(median))
        answers[f"{axis}_high_mm"] = answers[f"{axis}_mm"] + rng.uniform(10, 50, len(median))
    return answers


def mean_where(contacts: Contacts, value: Callable[[int, Floats], float], holds: Callable[[Floats], bool]) -> float:
    """The weighted mean of values of all likely places that a condition holds for."""
    weight = contacts.drawn.weight
    pairs = [(row, place) for row, places in enumerate(contacts.likely_mm) for place in places if holds(place)]
    total = sum(weight[row] for row, _ in pairs)
    return float(sum(weight[row] * value(row, place) for row, place in pairs) / total) if total else np.nan


def assert_part(
    found: Part, contacts: Contacts, answers: dict[str, Floats], axes: tuple[str, ...], holds: Callable[[Floats], bool]
) -> None:
    stated = np.stack([answers[f"{axis}_mm"] for axis in axes], axis=1)
    error = mean_where(contacts, lambda row, place: float(np.linalg.norm(stated[row] - place)), holds)
    assert found.error_mm.value == pytest.approx(error)
    for number, axis in enumerate(axes):
        low, high = answers[f"{axis}_low_mm"], answers[f"{axis}_high_mm"]
        held = mean_where(contacts, lambda row, at, k=number, a=low, b=high: float(a[row] <= at[k] <= b[row]), holds)  # type: ignore[misc]
        assert found.held[number].value == pytest.approx(held)
        length = mean_where(contacts, lambda row, _, a=low, b=high: float(b[row] - a[row]), holds)  # type: ignore[misc]
        assert found.interval_mm[number].value == pytest.approx(length)


def test_a_beam_has_stretches_a_middle_and_two_ends() -> None:
    """24 stretches of 10 mm; the middle third is from 100 to 180 mm."""
    contacts = contacts_of(BEAM)
    answers = answers_to(contacts, ("position",))
    found = profile_of(contacts, answers, BEAM, 3)
    (edges,) = found.edges_mm
    assert edges == pytest.approx(np.arange(20, 261, 10))
    assert found.position_mm == pytest.approx(np.arange(25, 260, 10))
    model, limit = found.model_mm, found.limit_mm
    for number in range(24):
        low, high = 20 + 10 * number, 30 + 10 * number

        def within(place: Floats, low: float = low, high: float = high) -> bool:
            return bool(low <= place[0] < high or high == 260 == place[0])

        of_model = mean_where(contacts, lambda row, at: abs(float(answers["position_mm"][row] - at[0])), within)
        assert model[number] == pytest.approx(of_model)
        of_limit = mean_where(contacts, lambda row, at: abs(float(contacts.median_mm[row, 0] - at[0])), within)
        assert limit[number] == pytest.approx(of_limit)
    parts: list[tuple[Part, str, Callable[[Floats], bool]]] = [
        (found.whole, "whole range", lambda _: True),
        (found.middle, "middle third", lambda place: bool(100 <= place[0] < 180)),
        (found.first, "left end, to 30 mm", lambda place: bool(place[0] < 30)),
        (found.last, "right end, from 250 mm", lambda place: bool(place[0] >= 250)),
    ]
    for part, name, holds in parts:
        assert part.name == name
        assert_part(part, contacts, answers, ("position",), holds)
    assert found.force_n is not None
    assert found.force_n.value == pytest.approx(0.25)
    assert found.regions == ()


def test_a_plate_has_parts_of_equal_length_a_middle_a_rim_and_corners() -> None:
    """Of 320 by 200 mm: 8 by 5 parts of 40 mm. A rim is 5 % wide, a corner 10 % along both axes."""
    contacts = contacts_of(PLATE)
    answers = answers_to(contacts, ("x", "y"))
    del answers["force_n"]
    found = profile_of(contacts, answers, PLATE, 3)
    assert [edges.tolist() for edges in found.edges_mm] == [list(range(10, 331, 40)), list(range(50, 251, 40))]
    stated = np.stack([answers["x_mm"], answers["y_mm"]], axis=1)
    of_model = [
        mean_where(
            contacts,
            lambda row, place: float(np.linalg.norm(stated[row] - place)),
            lambda place, i=column, j=row: (  # type: ignore[misc]
                min((place[0] - 10) // 40, 7) == i and min((place[1] - 50) // 40, 4) == j
            ),
        )
        for column in range(8)
        for row in range(5)
    ]
    assert found.model_mm == pytest.approx(np.array(of_model), nan_ok=True)
    parts: list[tuple[Part, str, Callable[[Floats], bool]]] = [
        (found.whole, "whole range", lambda _: True),
        (
            found.middle,
            "middle half along each axis",
            lambda place: bool(90 < place[0] < 250 and 100 < place[1] < 200),
        ),
        (
            found.first,
            "rim, the outer 5 % at each edge",
            lambda place: bool(not 26 <= place[0] <= 314 or not 60 <= place[1] <= 240),
        ),
        (
            found.last,
            "corners, the outer 10 % along both axes",
            lambda place: bool(not 42 <= place[0] <= 298 and not 70 <= place[1] <= 230),
        ),
    ]
    for part, name, holds in parts:
        assert part.name == name
        assert_part(part, contacts, answers, ("x", "y"), holds)
    assert found.force_n is None


def test_a_part_without_contacts_has_no_error_and_a_model_without_intervals_none() -> None:
    contacts = contacts_of(BEAM)
    likely = np.where((contacts.likely_mm >= 50) & (contacts.likely_mm < 60), 65.0, contacts.likely_mm)
    away = Contacts(contacts.drawn, likely, contacts.median_mm, contacts.distance_mm)
    found = profile_of(away, {"position_mm": contacts.median_mm[:, 0]}, BEAM, 3)
    assert np.flatnonzero(np.isnan(found.model_mm)).tolist() == np.flatnonzero(np.isnan(found.limit_mm)).tolist() == [3]
    assert (found.whole.held, found.whole.interval_mm, found.force_n) == ((), (), None)


def test_honest_trials_keep_the_bound_in_nineteen_of_twenty_cases() -> None:
    """Half of the errors are 1 mm, with a weight of 0.6, the others none: of 20 the share of a binomial of 0.3."""
    place, error, weight = np.linspace(0.0, 24.0, 960), np.tile([1.0, 0.0], 480), np.tile([0.6, 1.4], 480)
    drawn = Draws(place[:, None], np.ones(960), np.zeros((960, 2)), weight)
    contacts = Contacts(drawn, place[:, None, None], place[:, None], np.zeros(960))
    found = profile_of(contacts, {"position_mm": place + error}, Extent.of_beam((0.0, 24.0)), 4)
    assert found.accepted_mm == pytest.approx(binom.ppf(0.95, 20, 0.3) / 20)


@pytest.mark.parametrize(
    ("size_mm", "counts"), [((320.0, 200.0), (28, 18)), ((200.0, 320.0), (18, 28)), ((300.0, 2.0), (28, 1))]
)
def test_parts_are_as_long_along_either_axis(size_mm: tuple[float, float], counts: tuple[int, int]) -> None:
    extent = Extent(((5.0, 5.0 + size_mm[0]), (7.0, 7.0 + size_mm[1])))
    edges = edges_of(extent, 28)
    assert tuple(len(ends) - 1 for ends in edges) == counts
    assert [(float(ends[0]), float(ends[-1])) for ends in edges] == list(extent.ranges_mm)


@pytest.mark.parametrize("force_n", [(2.0, 5.0), (3.0, 3.0)])
def test_regions_are_those_of_answers_to_the_weakest_and_the_strongest_at_nine_places(
    force_n: tuple[float, float],
) -> None:
    """Under 1 N at x, the sensors show 0.1, x / 1000 and 0 mm; an interval is 2 mm long."""

    def shown(place_mm: Floats) -> Floats:
        x = place_mm[:, 0]
        return np.stack([np.full(len(x), 0.1), x / 1000, np.zeros(len(x))], axis=1)

    prior = Prior(PLATE, 400.0, force_n, Errors(0.004), 3, shown)
    found = regions_of(prior, model_of(outputs=PLATE_OUTPUTS))
    expected = [(x, y, force) for x in (42, 170, 298) for y in (70, 150, 230) for force in sorted(set(force_n))]
    assert [(*each.place_mm, each.force_n) for each in found] == pytest.approx(np.array(expected))
    assert [each.correlation for each in found] == pytest.approx([f * (0.1 + x / 1000) / 2 for x, _, f in expected])
    assert np.array([each.deviation_mm for each in found]) == pytest.approx(1 / 1.959964, rel=1e-4)
