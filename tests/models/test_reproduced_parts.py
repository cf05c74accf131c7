"""The whole reproduction: its parts in their order, each with the seed, and how far it is."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.estimators.paper_network import MAX_EPOCHS
from beamtouch_models.lab.reproduction import reproduce as whole
from beamtouch_models.lab.reproduction.figures import figure_2
from beamtouch_models.lab.reproduction.paper import Figure
from beamtouch_models.lab.reproduction.reproduce import reproduce


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the parts are asked for; figures are the second one under other numbers, and 5 to 8 are made at once."""
    asked, second = dict[str, Any](), figure_2()

    def numbered(number: int) -> Figure:
        return replace(second, number=number)

    def part(name: str, made: Any) -> Callable[..., Any]:  # noqa: ANN401
        def make(*given: object, **how: object) -> Any:  # noqa: ANN401
            asked[name] = (*given, how) if how else given
            if (progress := how.get("progress")) is not None:
                for done in (0.0, 0.5, 1.0):
                    progress(done)  # type: ignore[operator]
            return made

        return make

    best = np.array([70.0, 150.0, 250.0, 330.0])
    layouts: dict[tuple[int, str], Floats] = {(2, "equal"): best[:2], (4, "equal"): best + 1, (4, "optimised"): best}
    for name, made in (
        ("figure_2", numbered(2)), ("figure_3", numbered(3)), ("figure_4", numbered(4)),
        ("figures_5_and_6", (numbered(5), numbered(6))), ("layouts_of", layouts), ("figure_7", numbered(7)),
        ("measure", {"networks": 2}), ("figure_8", numbered(8)),
    ):  # fmt: skip
        monkeypatch.setattr(whole, name, part(name, made))
    asked["layouts"], asked["best"] = layouts, best
    return asked


def test_all_figures_are_made_in_order_with_one_seed(asked: dict[str, Any]) -> None:
    steps = list[tuple[str, float]]()
    found = reproduce(9, lambda text, share: steps.append((text, share)), networks=2, max_epochs=50)
    assert [figure.number for figure in found.figures] == [2, 3, 4, 5, 6, 7, 8]
    assert (found.seed, len(found.misprints)) == (9, 3)
    assert (asked["figure_4"], asked["figures_5_and_6"], asked["layouts_of"]) == ((9,), (9,), (9,))
    assert asked["figure_7"][0] is asked["best"]
    layouts, seed, how = asked["measure"]
    assert (layouts is asked["layouts"], seed, how["networks"], how["max_epochs"]) == (True, 9, 2, 50)
    assert asked["figure_8"] == ({"networks": 2},)
    assert [text for text, _ in steps] == [
        "figures 2 to 4", "the paper's search", "placing two to five sensors", *["training the paper's networks"] * 3,
    ]  # fmt: skip
    shares = [share for _, share in steps]
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert shares[2] < 0.2
    assert np.diff(shares[3:]) == pytest.approx([0.4, 0.4])  # training takes most of the time
    assert 0.9 < shares[-1] < 1.0


def test_by_default_three_networks_are_trained_to_the_end(asked: dict[str, Any]) -> None:
    reproduce(0, lambda *_: None)
    *_, how = asked["measure"]
    assert (how["networks"], how["max_epochs"]) == (3, MAX_EPOCHS)
