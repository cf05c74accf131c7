"""Objects of the physics that hold arrays: each is itself, and equal to no other, so that it may be in a set."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beamtouch_models import resolve
from beamtouch_models.design.layout import Layout
from beamtouch_models.design.physics.characteristic_fit import Characteristic
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.physics.measured_structure import measured_structure_of
from beamtouch_models.design.physics.plate import free_plate, supported_plate
from beamtouch_models.design.physics.smooth_fit import SmoothFit
from beamtouch_models.design.physics.smoothness import Smoothness
from beamtouch_models.design.physics.theory_fit import Gains, KnownLoads, Theory, TheoryFit
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Placement
from beamtouch_models.design.scene.measured_loads import parse_loads
from models.load_tables import table
from models.scene_limits import BEAM, PLATE, beam, made
from support.surfaces.tapered_leaf import loads_csv, scene_of

PLACES = np.linspace(10, 90, 6)


def theory() -> Theory:
    return Theory(PLACES, PLACES[:, None] / 100)


def loads() -> KnownLoads:
    return KnownLoads(PLACES, np.full(6, 2.0), PLACES[:, None] / 50, PLACES[:, None] / 100)


def fit() -> SmoothFit:
    return SmoothFit.of(PLACES[:, None], np.sin(PLACES[:, None] / 30), np.ones(6))


MADE: dict[str, Any] = {
    "loads": lambda: parse_loads(table(), "x"),
    "theory": theory,
    "known loads": loads,
    "gains": lambda: Gains.fit(loads(), 0.01, curved=False),
    "fit of a theory": lambda: TheoryFit.of(theory(), loads(), 0.01, curved=False),
    "smooth fit": fit,
    "measured": lambda: fit().measured[0],
    "process": lambda: fit().measured[0].process(Smoothness(1, 0.1, 0.0, (0.3,))),
    "characteristic": lambda: Characteristic(np.array([-1.0, 0, 1]), np.array([-1.0, 0, 1])),
    "structure": lambda: measured_structure_of(scene_of(influence=loads_csv(16))).scaled(1.0),
    "influence": lambda: InfluenceFunction(100.0, PLACES, (1.0, 1.0), lambda sensor, load: np.outer(load, sensor)),
}


@pytest.mark.parametrize("name", MADE)
def test_an_object_is_equal_to_itself_only(name: str) -> None:
    one, other = MADE[name](), MADE[name]()
    assert len({one, one, other}) == 2


def test_a_layout_is_equal_to_itself_only() -> None:
    placement = Placement(np.array([[130.0], [270.0]]), 1.0, 5)
    layout = Layout(resolve(made(BEAM, beam(supports="simply-supported"))), placement, DEFAULT_AIM)
    assert len({layout, layout, replace(layout)}) == 2
    assert len({placement, placement, replace(placement)}) == 2


def test_a_plate_that_was_factored_is_equal_to_itself_only() -> None:
    plate = made(PLATE).plate
    assert plate is not None
    assert len({supported_plate(plate), free_plate(1.0, 0.75, 0.3), free_plate(1.0, 0.5, 0.3)}) == 3
