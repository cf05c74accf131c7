"""The fewest sensors whose accuracy limit meets a requirement, under a string that is pulled."""

from functools import cache

import numpy as np
import pytest

from beamtouch_models.design.accuracy.limit import accuracy_limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.placement.placing import Aim, Placement, fewest_sensors
from beamtouch_models.design.placement.position_error import Sampling
from beamtouch_models.errors import SceneError
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors
from models.loaded_string import STRING

PLACES_MM = np.arange(40.0, 361.0, 40.0)
SAMPLING = Sampling(Errors(0.05))
BY_PRODUCT = Aim("eigenvalue-product", effort=Effort(0.01))


def fewest(
    wanted_mm: float | None, counts: tuple[int, int] = (2, 5), aim: Aim = BY_PRODUCT, fixed: tuple[int, ...] = ()
) -> Placement:
    rules = LayoutRules(on_axis(PLACES_MM), np.array(fixed, dtype=np.intp), 0.0)
    return fewest_sensors(STRING, rules, counts, wanted_mm=wanted_mm, sampling=SAMPLING, seed=3, aim=aim)


@cache
def limit_mm(count: int) -> float:
    """The limit of the layout with so many sensors, as a user would ask for it."""
    prior = Prior.of(STRING, fewest(None, (count, count)).place_mm, SAMPLING.errors)
    return accuracy_limit(prior, 1000, 3).value / 100 * 400


def test_the_first_number_that_meets_the_requirement_is_taken() -> None:
    limits = {count: limit_mm(count) for count in (2, 3, 4)}
    assert limits[2] > limits[3] > limits[4]
    assert len(fewest(1.0001 * limits[3]).place_mm) == 3
    assert len(fewest(0.9999 * limits[3]).place_mm) == 4
    # Fixed sensors are placed at least, and so many as the scene asks for.
    assert len(fewest(400.0, fixed=(0, 3, 7)).place_mm) == 3
    assert len(fewest(400.0, (4, 6)).place_mm) == 4
    assert len(fewest(None, (1, 1)).place_mm) == 1


def test_what_cannot_be_reached_is_said_with_what_can() -> None:
    with pytest.raises(SceneError) as refused:
        fewest(1e-3, (2, 3))
    assert str(refused.value) == (
        f"not even 3 sensors reach requirements.position_error_mm = 0.001: the accuracy limit is {limit_mm(3):.3g} mm; "
        "use sensors with less noise or allow more latency_ms"
    )
    # There are nine places.
    with pytest.raises(SceneError, match=r"^not even 9 sensors reach .* mm; and 10 sensors do not fit on 9 places"):
        fewest(1e-3, (9, 12))
    with pytest.raises(SceneError, match=r"^10 sensors do not fit on 9 places"):
        fewest(1e-3, (10, 12))
    with pytest.raises(SceneError, match=r"^sensors.count leaves the number open; give requirements.position_error_mm"):
        fewest(None)


def test_of_sensors_one_of_which_has_always_failed_there_are_two_at_least() -> None:
    with pytest.raises(SceneError, match="failed_percent = 100 needs at least 2 sensors, not 1; use more, or set sens"):
        fewest(None, (1, 1), Aim("position-error", 100.0, effort=Effort(0.01)))
