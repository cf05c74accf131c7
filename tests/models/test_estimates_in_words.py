"""Estimates in words: a figure has as many decimals as its interval is worth, and no more than four digits."""

import numpy as np
import pytest

from beamtouch_models.design.model import Estimates


def told(state: str = "contact", *, channels: int = 4, **figures: float) -> str:
    values = {name: np.array([value]) for name, value in figures.items()}
    return repr(Estimates(values, state=np.array([state]), channels=np.array([channels])))


@pytest.mark.parametrize(
    ("value", "low", "high", "words"),
    [
        (47.83, 42.91, 52.44, "47.8 mm (42.9 to 52.4)"),  # a twentieth of the interval is 0.48: one decimal
        (47.8312, 47.8051, 47.8568, "47.83 mm (47.81 to 47.86)"),  # of three that it is worth, four digits have two
        (147.8312, 147.8051, 147.8568, "147.8 mm (147.8 to 147.9)"),
        (1047.83, 1047.8, 1047.9, "1048 mm (1048 to 1048)"),
        (47.83, 32.6, 62.4, "48 mm (33 to 62)"),
        (47.83, 37.9, 57.8, "47.8 mm (37.9 to 57.8)"),
        (0.5123, 0.5001, 0.5302, "0.512 mm (0.500 to 0.530)"),
        (-0.5123, -0.5302, -0.5001, "-0.512 mm (-0.530 to -0.500)"),
    ],
)
def test_decimals_are_those_of_a_twentieth_of_the_interval(value: float, low: float, high: float, words: str) -> None:
    assert told(position_mm=value, position_low_mm=low, position_high_mm=high) == f"contact at {words}"
    force = words.replace("mm", "N")
    both = told(position_mm=1.0, force_n=value, force_low_n=low, force_high_n=high)
    assert both == f"contact at 1 mm with {force}"


def test_a_figure_without_an_interval_has_four_digits() -> None:
    assert told(position_mm=123.4567) == "contact at 123.5 mm"
    assert told(x_mm=12.3456, y_mm=4.5) == "contact at 12.35 mm and 4.5 mm"


@pytest.mark.parametrize(
    ("figures", "channels", "few"),
    [
        ({"position_mm": 1.0}, 2, True),
        ({"position_mm": 1.0}, 3, False),
        ({"x_mm": 1.0, "y_mm": 2.0}, 3, True),
        ({"x_mm": 1.0, "y_mm": 2.0}, 4, False),
    ],
)
def test_few_channels_are_told(figures: dict[str, float], channels: int, *, few: bool) -> None:
    said = f"; {channels} channels hardly tell it from other loads"
    assert told("contact", channels=channels, **figures).endswith(said) == few


def test_other_states_have_no_figures() -> None:
    assert told("clear", position_mm=1.0) == "clear, nothing touches"
    assert told("unexplained", position_mm=1.0) == "unexplained: not one contact, or a wrong sensor"
    several = Estimates(
        position_mm=np.array([1.0, np.nan]), state=np.array(["contact", "clear"]), channels=np.array([4, 4])
    )
    assert repr(several) == "contact at 1 mm\nclear, nothing touches"
