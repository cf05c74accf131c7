"""Which answers of a model are served as figures, and how they and times are written."""

from math import inf, nan

import numpy as np
import pytest

from beamtouch_common.outline import Outline, Span
from beamtouch_models.runtime import Evidence
from beamtouch_service.surfaces.contact import (
    Figures,
    UnusableEstimateError,
    figures_of,
    require_usable,
    rfc3339,
)

BEAM = Outline.of_beam(400.0)


def answer(position_mm: float, low_mm: float, high_mm: float, **more: float) -> dict[str, float]:
    return {"position_mm": position_mm, "position_low_mm": low_mm, "position_high_mm": high_mm} | more


def test_figures_have_four_decimals() -> None:
    force = {"force_n": 2.00004, "force_low_n": 1.00006, "force_high_n": 3.0, "misfit": 9.0}
    figures = figures_of(answer(100.00005001, 99.0, 101.0, **force), BEAM)
    assert figures == Figures({"position": Span(100.0001, 99.0, 101.0)}, Span(2.0, 1.0001, 3.0))
    assert figures_of(answer(100.0, 99.0, 101.0), BEAM).force is None


@pytest.mark.parametrize(
    ("position_mm", "low_mm", "high_mm", "is_served"),
    [
        (-1.0, -2.0, 0.0, True),
        (-1.0, -2.0, -0.1, False),
        (401.0, 400.0, 402.0, True),
        (401.0, 400.1, 402.0, False),
    ],
)
def test_an_interval_must_meet_the_beam(position_mm: float, low_mm: float, high_mm: float, is_served: bool) -> None:
    stated = answer(position_mm, low_mm, high_mm)
    if is_served:
        assert figures_of(stated, BEAM).place["position"].middle == position_mm
    else:
        with pytest.raises(UnusableEstimateError, match=f"^position_mm is {position_mm:g}, off a beam of 400 mm$"):
            figures_of(stated, BEAM)


PLATE = Outline({"x": 400.0, "y": 300.0})


@pytest.mark.parametrize(("y_mm", "is_served"), [(0.0, True), (301.0, True), (301.1, False), (-1.1, False)])
def test_an_interval_must_meet_a_plate_along_each_axis(y_mm: float, is_served: bool) -> None:
    stated = {"x_mm": 350.0, "x_low_mm": 349.0, "x_high_mm": 351.0}
    stated |= {"y_mm": y_mm, "y_low_mm": y_mm - 1, "y_high_mm": y_mm + 1}
    if is_served:
        place = {"x": Span(350.0, 349.0, 351.0), "y": Span(y_mm, y_mm - 1, y_mm + 1)}
        assert figures_of(stated, PLATE).place == place
    else:
        with pytest.raises(UnusableEstimateError, match=f"^y_mm is {y_mm:g}, off a plate of 400 by 300 mm$"):
            figures_of(stated, PLATE)


@pytest.mark.parametrize(
    ("stated", "served"), [(-1.0, -1.0), (1.00004, 1.0), (1.0001, None), (-1.0001, None), (4.0, None)]
)
def test_a_correlation_lies_between_minus_one_and_one(stated: float, served: float | None) -> None:
    names = ("x_mm", "x_low_mm", "x_high_mm", "y_mm", "y_low_mm", "y_high_mm")
    given = dict.fromkeys(names, 100.0) | {"place_correlation": stated}
    if served is not None:
        assert figures_of(given, PLATE).correlation == served
    else:
        with pytest.raises(UnusableEstimateError, match=f"^place_correlation is {stated:g}, beyond -1 to 1$"):
            figures_of(given, PLATE)


def test_no_figure_is_served_without_its_interval() -> None:
    with pytest.raises(UnusableEstimateError, match=r"^position_low_mm is not a finite number$"):
        figures_of({"position_mm": 100.0}, BEAM)


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_what_is_no_number_is_named(value: float) -> None:
    with pytest.raises(UnusableEstimateError, match=r"^force_low_n is not a finite number$"):
        figures_of(answer(1.0, 0.0, 2.0, force_n=1.0, force_low_n=value), BEAM)


def test_a_time_has_milliseconds_and_is_cut_rather_than_rounded() -> None:
    assert rfc3339(1_795_218_046_123_999) == "2026-11-20T23:40:46.123Z"
    assert [rfc3339(us) for us in (0, -1)] == ["1970-01-01T00:00:00.000Z", "1969-12-31T23:59:59.999Z"]


@pytest.mark.parametrize("name", ["contact_log_odds", "misfit"])
def test_nothing_is_decided_on_what_is_no_number(name: str) -> None:
    weights = np.eye(1)

    def evidence(**answer: float) -> Evidence:
        return Evidence(np.zeros(1), weights, answer, 1, 0.0, False, 0.0, weights, True)

    require_usable(evidence())
    require_usable(evidence(contact_log_odds=1.0, misfit=2.0))
    with pytest.raises(UnusableEstimateError, match=f"^{name} is not a finite number$"):
        require_usable(evidence(**({"contact_log_odds": 1.0, "misfit": 2.0} | {name: nan})))
