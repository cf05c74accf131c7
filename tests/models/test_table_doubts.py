"""Doubts about a table of loads: the numbers in a message are those of its fit."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.smooth_fit import SmoothFit
from beamtouch_models.design.physics.table_doubts import FittedAt, find_fault
from beamtouch_models.places import grid_of

PLACE_MM = np.linspace(10, 290, 15)[:, None]
FORCE_N = np.tile([5.0, 8.0, 4.0], 5)
SHAPE = np.column_stack([np.sin(PLACE_MM[:, 0] / 95), 0.5 + PLACE_MM[:, 0] / 600])
NAMES = ("a", "b")


def contacts_of(deviation: Floats | float, mean: Floats = SHAPE) -> FittedAt:
    return FittedAt(PLACE_MM, mean, deviation * np.ones_like(mean))


def fitted(values: Floats = SHAPE) -> SmoothFit:
    return SmoothFit.of(PLACE_MM, values, FORCE_N)


@pytest.fixture(scope="module")
def fit() -> SmoothFit:
    return fitted(SHAPE * (1 + 0.002 * np.random.default_rng(4).normal(size=SHAPE.shape)))


def told(fit: SmoothFit, values: Floats, contacts: FittedAt) -> str:
    return find_fault(fit, values, FORCE_N[: len(values)], contacts, NAMES, "V")


def test_a_table_that_agrees_is_taken(fit: SmoothFit) -> None:
    assert told(fit, SHAPE, contacts_of(0.01)) == ""


def test_a_sensor_that_shows_one_load_only_is_named_and_one_that_shows_two_is_not(fit: SmoothFit) -> None:
    silent = np.where(np.arange(15)[:, None] == 3, SHAPE, SHAPE * [1, 0])
    assert told(fit, silent, contacts_of(0.01)) == "b shows 0 under all loads but one; check it, or take it out"
    silent[4] = SHAPE[4]
    assert "shows 0 under" not in told(fit, silent, contacts_of(0.01))


@pytest.mark.parametrize(
    ("count", "wrong", "times", "again"),
    [
        (15, [6], [1.2], "measure it again, or take it out"),
        (24, [17, 5], [9.0, 1.7], "measure each of these loads again, or take them out"),
    ],
)
def test_loads_that_contradict_the_others_are_named_with_what_these_say(
    count: int, wrong: list[int], times: list[float], again: str
) -> None:
    place_mm, force_n = np.linspace(10, 290, count)[:, None], np.tile([5.0, 8.0, 4.0], count // 3)
    shape = np.column_stack([np.sin(place_mm[:, 0] / 95), 0.5 + place_mm[:, 0] / 600])
    values = shape * (1 + 0.002 * np.random.default_rng(4).normal(size=shape.shape))
    values[wrong, 0] *= times
    said = find_fault(SmoothFit.of(place_mm, values, force_n), values, force_n, contacts_of(0.01), NAMES, "V")
    *named, last = said.split("; ")
    assert last == again
    assert len(named) == len(wrong)
    for load in wrong:
        (line,) = [line for line in named if line.startswith(f"under the load at {place_mm[load, 0]:g} mm")]
        told = re.search(r"with ([0-9.]+) N, a shows ([0-9.]+) V, but the others say ([0-9.]+)$", line)
        assert told
        force, shown, by_others = map(float, told.groups())
        assert force == force_n[load]
        assert shown == pytest.approx(force * values[load, 0], rel=0.005)
        assert by_others == pytest.approx(force * shape[load, 0], rel=0.05)


def test_a_load_that_is_off_by_less_than_a_tenth_of_what_a_sensor_shows_is_not_named() -> None:
    values = SHAPE * (1 + 0.002 * np.random.default_rng(4).normal(size=SHAPE.shape))
    values[6, 0] *= 1.07
    assert "others say" not in told(fitted(values), values, contacts_of(0.01))


def test_loads_on_a_kink_do_not_contradict() -> None:
    kinked = np.column_stack([1 - np.abs(PLACE_MM[:, 0] - 150) / 200, SHAPE[:, 1]])
    assert "others say" not in told(fitted(kinked), kinked, contacts_of(0.01, kinked))


def scattering(fit: SmoothFit, scatter: list[float]) -> SmoothFit:
    """Return a fit that says so of how loads repeat."""
    other = replace(fit)
    other.__dict__["repeatability"] = np.array(scatter)
    return other


LARGEST = np.sqrt((SHAPE**2).mean(axis=0))


def test_sensors_that_do_not_repeat_are_named(fit: SmoothFit) -> None:
    assert told(scattering(fit, [0.1, 0.2] * LARGEST), SHAPE, contacts_of(0.01)) == ""
    assert told(scattering(fit, [0.1, 0.234] * LARGEST), SHAPE, contacts_of(0.01)) == (
        "b repeats to 23 % of what it shows only, as if loads did not stand where the table says; measure again what "
        "differs, or take b out"
    )
    assert told(scattering(fit, [0.31, 0.234] * LARGEST), SHAPE, contacts_of(0.01)).startswith(
        "all sensors repeat to 23 % of what they show or worse, as if loads did not stand where the table says, or had"
    )


def test_a_table_is_too_sparse_where_most_sensors_are_unknown(fit: SmoothFit) -> None:
    unknown = np.full_like(SHAPE, 0.01)
    unknown[8] = 0.2 * LARGEST
    contacts = FittedAt(PLACE_MM, SHAPE, unknown)
    said = told(fit, SHAPE, contacts)
    assert said.startswith(
        "the loads are too far apart for contact.position_mm: at 170 mm, 20 % of the influence is unknown, and more "
        "than 10 % is not trusted; 1 loads more would do, first at 170 mm, or narrow contact.position_mm"
    )
    unknown[8] = 0.0999 * LARGEST
    assert told(fit, SHAPE, contacts) == ""
    # The median of both sensors.
    unknown[8] = [0.01, 0.2] * LARGEST
    assert "14 % of the influence is unknown" in told(fit, SHAPE, contacts)


class Asked(SmoothFit):
    """A fit of which so many further loads, each at another place, leave nothing unknown."""

    enough = 1

    def variance_with(self, more_mm: Floats, place_mm: Floats) -> Floats:
        variance = np.full((len(place_mm), 2), 1e-4)
        if len(more_mm) < self.enough:
            variance[len(more_mm)] = 0.3**2
        return variance


@pytest.mark.parametrize(
    ("enough", "would"),
    [
        (1, "1 loads more would do, first at 0 mm"),
        (5, "5 loads more would do, first at 0, 20, 40 mm"),
        (40, "40 loads more would do"),
        (41, "more than 40 loads more are needed"),
    ],
)
def test_a_message_says_how_many_more_loads_would_do(
    fit: SmoothFit, monkeypatch: pytest.MonkeyPatch, enough: int, would: str
) -> None:
    monkeypatch.setattr(Asked, "enough", enough)
    asked = Asked(**{field.name: getattr(fit, field.name) for field in fields(fit)})
    unknown = np.full((100, 2), 0.05)
    unknown[0] = 0.256
    contacts = FittedAt(np.linspace(0, 1980, 100)[:, None], np.ones((100, 2)), unknown)
    said = told(asked, SHAPE, contacts)
    assert f"at 0 mm, 26 % of the influence is unknown, and more than 10 % is not trusted; {would}" in said


def test_on_two_axes_more_may_be_unknown_and_lines_are_not_asked() -> None:
    place_mm = grid_of([np.linspace(0, 60, 5), np.linspace(0, 40, 4)])
    x, y = place_mm.T / 50
    values = np.column_stack([1 + x * y, 2 - x + y**2])
    values = values * (1 + 0.002 * np.random.default_rng(3).normal(size=values.shape))
    force_n = np.full(20, 5.0)
    fit, largest = SmoothFit.of(place_mm, values, force_n), np.sqrt((values**2).mean(axis=0))
    unknown = np.full_like(values, 0.01)
    unknown[7] = 0.39 * largest
    contacts = FittedAt(place_mm, values, unknown)
    assert find_fault(fit, values, force_n, contacts, NAMES, "mm") == ""
    unknown[7] = 0.43 * largest
    said = find_fault(fit, values, force_n, contacts, NAMES, "mm")
    assert said.startswith(
        "the loads are too far apart for contact.x_mm and y_mm: at (15, 40) mm, 43 % of the influence is unknown, and "
        "more than 40 % is not trusted; 1 loads more would do, first at (15, 40) mm, or narrow contact.x_mm and y_mm"
    )
    wrong = values.copy()
    wrong[9, 1] *= 2
    said = find_fault(SmoothFit.of(place_mm, wrong, force_n), wrong, force_n, contacts, NAMES, "mm")
    assert said.startswith("under the load at (30, 13.3333) mm with 5 N, b shows")
