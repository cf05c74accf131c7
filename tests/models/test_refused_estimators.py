"""Which estimators `build` refuses: those that miss the accuracy limit or their intervals by more than chance."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from beamtouch_models import change_scene, read_scene
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.limit import Reached
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.building.measure import reach
from beamtouch_models.design.scene import Scene
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.session import Answers
from support.surfaces.example_scenes import SCENES, paper_scene

NOISE_MM = 0.004
HELD_95 = 100 * NOISE_MM * norm.isf(0.025)
"""Half an interval that holds 95 % of errors of 100 noises."""


def shown(place_mm: Floats) -> Floats:
    """Only the second of three channels tells the place, 100 mm for each of its mm."""
    x = place_mm[:, 0]
    return np.stack([np.ones(len(x)), x / 100 - 1, np.zeros(len(x))], axis=1)


PRIOR = Prior(Extent.of_beam((0.0, 400.0)), 400.0, (1.0, 1.0), Errors(NOISE_MM), 3, shown)


def answering(times: float = 1.0, half_mm: float = HELD_95, bad: float = 0.0) -> Callable[..., Answers]:
    """Return a graph whose errors are so many times the least ones, and whose intervals have this half."""
    more = np.sqrt(times**2 - 1)

    def run(deflection_mm: NDArray[np.floating], _whitening: NDArray[np.floating]) -> Answers:
        place: Any = 100 + 100 * (deflection_mm[:, 1] + more * deflection_mm[:, 2])
        place[0] += bad
        return {"position_mm": place, "position_low_mm": place - half_mm, "position_high_mm": place + half_mm}

    return run


def reached(run: Callable[..., Answers], name: str = "posterior", scene: Scene | None = None) -> Reached:
    made: Any = SimpleNamespace(name=name)
    return reach(made, PRIOR, run, 2048, 3, scene or paper_scene())


def test_a_posterior_at_its_limit_is_taken_with_its_figures() -> None:
    found = reached(answering())
    assert found.error_mm.value == pytest.approx(100 * NOISE_MM * (2 / np.pi) ** 0.5, rel=0.02)
    assert found.ratio.value == pytest.approx(1.0, abs=0.01)


def held_by(share: float) -> float:
    """Return half an interval that holds this share."""
    return float(100 * NOISE_MM * norm.isf((1 - share) / 2))


@pytest.mark.parametrize(
    ("times", "held", "is_taken"),
    [(1.15, 0.98, True), (1.3, 0.99, False), (1.0, 0.905, True), (1.0, 0.85, False), (1.0, 0.9999, True)],
)
def test_an_error_of_a_fifth_more_and_a_tenth_beyond_the_intervals_are_the_most(
    times: float, held: float, is_taken: bool
) -> None:
    run = answering(times, times * held_by(held))
    if is_taken:
        assert reached(run).ratio.value == pytest.approx(times, rel=0.02)
        return
    with pytest.raises(NotGoodEnoughError) as refused:
        reached(run)
    words = str(refused.value).split()
    assert " ".join(words[:10]) == f"with 0.004 mm of noise the error is {words[8]} times"
    assert float(words[8]) == pytest.approx(times, rel=0.02)
    share = float(words[words.index("and") + 1].removesuffix("%"))
    assert share == pytest.approx(100 * held, abs=1)
    assert str(refused.value).endswith("% of positions lie in their 95 % intervals; state a larger noise")


def test_a_network_may_miss_the_limit_but_no_answer_may_be_other_than_a_number() -> None:
    assert reached(answering(3.0), "small-network").ratio.value == pytest.approx(3.0, rel=0.03)
    for name in ("posterior", "small-network"):
        with pytest.raises(NotGoodEnoughError, match=r"some answers of the model are not finite; check the scene for"):
            reached(answering(bad=np.inf), name)


def test_a_plate_on_rigid_supports_is_put_on_springs() -> None:
    sprung = read_scene(SCENES / "plate-on-springs.toml")
    rigid = change_scene(sprung, plate={"support_stiffness_n_per_mm": None})
    for scene, advice in ((sprung, "state a larger noise"), (rigid, "put the plate on springs at its corners")):
        with pytest.raises(NotGoodEnoughError, match=f"intervals; {advice}$"):
            reached(answering(2.0), scene=scene)
