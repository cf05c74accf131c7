"""The contact that explains deflections best, beside scipy's non-negative least squares at each place."""

import numpy as np
import pytest
from scipy.optimize import nnls

from beamtouch_models.curve import Curve
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.scene import load_scene
from example_scenes import SCENES


@pytest.mark.parametrize("name", ["bench", "two-spans", "stepped"])
def test_no_place_of_a_contact_explains_deflections_better_than_the_best(name: str) -> None:
    scene, _ = load_scene(SCENES / f"{name}.toml")
    beam = influence_of(scene)
    sensor_mm = np.array([0.12, 0.26, 0.36, 0.7, 0.87]) * scene.beam.length_mm
    places_mm = np.linspace(beam.load_mm[0], beam.load_mm[-1], 301)
    influence = beam.at(sensor_mm, places_mm)
    rng = np.random.default_rng(4)
    contacts = influence[rng.integers(0, len(places_mm), 20)]
    pulls = -contacts  # beside a support, a contact on its other side comes near
    noise = 0.01 * np.abs(influence).max() * rng.normal(size=(60, 5))
    deflection_mm = np.concatenate([contacts, pulls, contacts + contacts[::-1]]) + noise
    weight = rng.uniform(0.5, 2.0, deflection_mm.shape)

    left = Curve(places_mm, influence).unexplained(deflection_mm, weight)

    root = np.sqrt(weight)
    for found, seen, by in zip(left, deflection_mm, root, strict=True):
        best = min(nnls((by * shape)[:, None], by * seen)[1] for shape in influence) ** 2
        assert found <= best * (1 + 1e-9)
