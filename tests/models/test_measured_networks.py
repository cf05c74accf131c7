"""What figure 8 measures of networks whose answers are known: the training, the noise, and the errors of a layout."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.lab.reproduction import figure_8
from beamtouch_models.lab.reproduction.figure_8 import NOISES_PERCENT, UNIT_MM, layouts_of, measure
from beamtouch_models.lab.reproduction.paper import deflection_mm, equal_pitch_mm

LARGEST_MM = 10 * 400**3 / (48 * 210e3 * 25 * 3**3 / 12)
"""Deflection in the middle under 10 N."""
LAYOUTS = {(2, "equal"): equal_pitch_mm(2), (3, "equal"): equal_pitch_mm(3)}


@dataclass
class Network:
    """Answers one place, whatever it is shown, and then one that is 3 mm farther right each time; keeps what it saw."""

    answer_mm: float
    epochs: int
    outcome: str = "reached"
    shown_mm: list[Floats] = field(default_factory=list)

    def estimate_mm(self, shown_mm: Floats) -> Floats:
        self.shown_mm.append(shown_mm)
        return np.full(len(shown_mm), self.answer_mm + 3 * (len(self.shown_mm) - 1))

    def error_percent(self, time: int = 0) -> float:
        """Of contacts that are even from 1 to 399 mm: halves of the squares of the ways to either end."""
        answer_mm = self.answer_mm + 3 * time
        return ((answer_mm - 1) ** 2 + (399 - answer_mm) ** 2) / 2 / 398 / 4


ANSWERS = (
    (200.0, 700), (120.0, 650), (60.0, 720), (300.0, 900), (40.0, 710), (250.0, 705), (390.0, 600), (10.0, 999)
)  # fmt: skip
"""Places and epochs of two networks for each layout, and of two for each that learn from noise."""

Trained = tuple[dict[str, Any], list[Network], list[Floats], dict[str, Any]]


@pytest.fixture(scope="module")
def trained() -> Trained:
    """The figures, the networks, the deflections that they learn from, and the other arguments of their training."""
    learnt, given = list[Floats](), dict[str, Any]()
    networks = [Network(place_mm, epochs) for place_mm, epochs in ANSWERS]
    networks[2].outcome = "stuck"

    def train(deflections_mm: Sequence[Floats], place_mm: Floats, length_mm: float, **how: object) -> list[Network]:
        learnt.extend(deflections_mm)
        given.update(how, place_mm=place_mm, length_mm=length_mm)
        return networks

    def limit(prior: Any, draws: int, seed: int) -> Measurement:  # noqa: ANN401
        given.setdefault("limits", []).append((prior.errors.noise_mm, draws, seed, prior.channels))
        return Measurement(3.5, 0.25)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figure_8, "train", train)
        patch.setattr(figure_8, "accuracy_limit", limit)
        steps: Callable[[float], None] = lambda _: None  # noqa: E731
        found = measure(LAYOUTS, 7, networks=2, max_epochs=123, progress=steps)
        given["is_told"] = given["progress"] is steps
    return found, networks, learnt, given


def test_each_layout_has_its_networks_on_clean_deflections_and_as_many_on_noisy_ones(trained: Trained) -> None:
    _, _, learnt, given = trained
    assert (given["seed"], given["max_epochs"], given["length_mm"], given["is_told"]) == (7, 123, 400.0, True)
    assert given["place_mm"].tolist() == list(range(1, 400))
    clean = [deflection_mm(LAYOUTS[count, "equal"]) for count in (2, 2, 3, 3)]
    for mm, expected in zip(learnt[:4], clean, strict=True):
        assert mm.tolist() == expected.tolist()
    for mm, expected in zip(learnt[4:], clean, strict=True):
        assert (mm - expected).std() == pytest.approx(0.02 * LARGEST_MM, rel=0.06)
    assert np.abs(learnt[4] - learnt[5]).max() > 0
    assert pytest.approx(LARGEST_MM / 100) == UNIT_MM


def test_errors_are_means_over_the_networks_of_a_layout(trained: Trained) -> None:
    found, networks, _, _ = trained
    errors = np.array([[network.error_percent(time) for time in range(15)] for network in networks])
    expected = np.array([errors[:2].mean(axis=0), errors[2:4].mean(axis=0)])
    assert found["error_at_noise_percent"] == pytest.approx(expected, rel=0.02)
    assert found["theoretical_percent"] == pytest.approx(expected[:, 0], rel=0.02)
    assert found["rig_percent"] == pytest.approx(expected[:, 14], rel=0.02)
    assert abs(expected[0, 14] / expected[0, 0] - 1) > 0.03
    assert found["noise_trained_percent"] == pytest.approx([errors[4:6, 0].mean(), errors[6:, 0].mean()], rel=0.02)
    spreads = [abs(one - other) / 2**0.5 for one, other in (errors[:2, 14], errors[2:4, 14])]
    assert found["rig_spread_percent"] == pytest.approx(spreads, rel=0.1, abs=0.2)
    assert (found["networks"], found["reached"], found["epochs"]) == (4, 3, [650, 900])
    assert found["layouts"] == list(LAYOUTS)
    assert [places.tolist() for places in found["positions_mm"]] == [places.tolist() for places in LAYOUTS.values()]
    assert found["noise_percent"] == NOISES_PERCENT


def test_the_same_noise_is_scaled_from_none_to_that_of_the_rig(trained: Trained) -> None:
    _, networks, _, _ = trained
    for network in networks[:4]:
        clean, *others = network.shown_mm
        assert len(clean) == 40_000
        for percent, shown_mm in zip(NOISES_PERCENT[1:], others, strict=True):
            assert (shown_mm - clean).std() == pytest.approx(percent / 100 * LARGEST_MM, rel=0.02)
        np.testing.assert_allclose((others[0] - clean) / NOISES_PERCENT[1], (others[-1] - clean) / 2, atol=1e-9)
    for network in networks[4:]:
        (shown_mm,) = network.shown_mm
        assert len(shown_mm) == 40_000
    assert (networks[4].shown_mm[0] == networks[0].shown_mm[-1]).all()
    assert networks[4].shown_mm[0].shape[1] == 2
    assert networks[6].shown_mm[0].shape[1] == 3


def test_the_limit_of_each_layout_is_that_at_the_noise_of_the_rig(trained: Trained) -> None:
    found, _, _, given = trained
    assert given["limits"] == [(pytest.approx(0.02 * LARGEST_MM), 8192, 7, count) for count in (2, 3)]
    assert (found["limit_percent"], found["limit_standard_error"]) == ([3.5, 3.5], [0.25, 0.25])


def test_layouts_are_those_at_equal_pitch_and_those_of_the_largest_product(monkeypatch: pytest.MonkeyPatch) -> None:
    class Placement:
        def __init__(self, count: int, seed: int) -> None:
            self.positions_mm = tuple(seed + 10.0 * place for place in range(count))

    monkeypatch.setattr(figure_8, "place", lambda _influence, _rules, count, seed: Placement(count, seed))
    layouts = {key: places.tolist() for key, places in layouts_of(3).items()}
    assert list(layouts) == [(count, kind) for count in (2, 3, 4, 5) for kind in ("equal", "optimised")]
    assert layouts[3, "equal"] == [100, 200, 300]
    assert layouts[4, "optimised"] == [3.0, 13.0, 23.0, 33.0]


@pytest.mark.parametrize("places_mm", [(200.0,), (200.0, 100.0, 20.0)])
def test_the_spread_is_that_of_a_sample_and_of_a_single_network_none(
    monkeypatch: pytest.MonkeyPatch, places_mm: tuple[float, ...]
) -> None:
    networks = [Network(place_mm, 1) for place_mm in places_mm]
    monkeypatch.setattr(figure_8, "train", lambda *_, **__: networks * 2)
    monkeypatch.setattr(figure_8, "accuracy_limit", lambda *_: Measurement(1.0, 0.1))
    monkeypatch.setattr(figure_8, "DRAWS", 20_000)
    found = measure({(2, "equal"): equal_pitch_mm(2)}, 7, networks=len(networks), max_epochs=1)
    errors = np.array([network.error_percent(14) for network in networks])
    expected = (((errors - errors.mean()) ** 2).sum() / max(len(errors) - 1, 1)) ** 0.5
    assert found["rig_spread_percent"] == pytest.approx([expected], rel=0.05, abs=1e-12)
