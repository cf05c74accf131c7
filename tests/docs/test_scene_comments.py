"""The figures in the first line of each shipped scene are those of its keys."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.pages.pasted import ROOT


def numbers_of(value: object) -> Iterator[float]:
    """Yield the numbers in a TOML value, lengths in mm also in m."""
    if isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from numbers_of(one)
    elif isinstance(value, int | float):
        yield from (value, value / 1e3)


@pytest.mark.parametrize("scene", sorted((ROOT / "models" / "scenes").glob("*.toml")), ids=lambda scene: scene.stem)
def test_the_figures_in_the_first_line_of_a_scene_are_its_own(scene: Path) -> None:
    first, _, rest = scene.read_text().partition("\n")

    assert {float(number) for number in re.findall(r"[\d.]*\d", first)} <= set(numbers_of(tomllib.loads(rest)))
