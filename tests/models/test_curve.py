"""The contact that explains deflections best, beside scipy's non-negative least squares at each place."""

import numpy as np
import pytest
from scipy.optimize import nnls

from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.physics.beam import influence, influence_of
from beamtouch_models.design.scene import change_scene, load_scene, read_scene
from beamtouch_models.design.scene.beam import Beam, changed_beam
from beamtouch_models.design.surface import resolve
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.curve import Curve
from beamtouch_models.runtime.departures import Departures
from support.surfaces.example_scenes import SCENES


@pytest.mark.parametrize("name", ["bench", "two-spans", "stepped"])
def test_no_entry_of_the_table_explains_deflections_better_than_the_best_contact(name: str) -> None:
    scene, _ = load_scene(SCENES / f"{name}.toml")
    beam = influence_of(scene)
    sensor_mm = np.array([0.12, 0.26, 0.36, 0.7, 0.87]) * scene.beam.length_mm
    places_mm = np.linspace(beam.load_mm[0], beam.load_mm[-1], 301)
    influence = beam.at(on_axis(sensor_mm), on_axis(places_mm))
    rng = np.random.default_rng(4)
    contacts = influence[rng.integers(0, len(places_mm), 20)]
    pulls = -contacts  # beside a support, a contact on its other side comes near
    noise = 0.01 * np.abs(influence).max() * rng.normal(size=(60, 5))
    deflection_mm = np.concatenate([contacts, pulls, contacts + contacts[::-1]]) + noise
    weight = rng.uniform(0.5, 2.0, deflection_mm.shape)

    left = Curve((places_mm,), influence).unexplained(deflection_mm, weight)

    root = np.sqrt(weight)
    moving = influence[np.abs(influence).max(axis=1) > 1e-9 * np.abs(influence).max()]  # not on a support
    for found, seen, by in zip(left, deflection_mm, root, strict=True):
        best = min(nnls((by * shape)[:, None], by * seen)[1] for shape in moving) ** 2
        assert found <= best * (1 + 1e-9)


def test_an_entry_on_a_support_where_only_rounding_is_left_is_no_contact() -> None:
    scene, _ = load_scene(SCENES / "two-spans.toml")
    sensor_mm, places_mm = np.array([115.0, 255.0, 357.0, 706.0, 875.0]), np.linspace(60.3, 939.7, 129)
    influence = influence_of(scene).at(on_axis(sensor_mm), on_axis(places_mm))
    assert 0 < np.abs(influence[64]).max() < 1e-12 * np.abs(influence).max()
    rng = np.random.default_rng(2)
    true_mm, true_n = rng.uniform(503, 515, 1000), rng.uniform(10, 60, 1000)
    noise = 0.0002 * rng.normal(size=(1000, 5))
    deflection_mm = true_n[:, None] * influence_of(scene).at(on_axis(sensor_mm), on_axis(true_mm)) + noise

    curve, weight = Curve((places_mm,), influence), np.full((1000, 5), 0.0002**-2)
    place_mm, force_n = curve.best_contacts(deflection_mm, weight)

    assert np.median(np.abs(place_mm[:, 0] - true_mm)) < 5
    assert ((force_n > 0) & (force_n < 1e4)).all()
    assert curve.unexplained(deflection_mm, weight).max() < 40


@pytest.mark.parametrize("key", ["none", "foundation_n_mm2", "shear_modulus_gpa"])
def test_the_influence_that_a_calibration_uses_again_is_that_of_the_stiffer_beam(key: str) -> None:
    """A foundation and shear stay what they are in a stiffer beam: they change the shape of its influence."""
    scene, sensor_mm = read_scene(SCENES / "bench.toml"), np.array([80.0, 160.0, 320.0])
    more = {"foundation_n_mm2": 0.05, "shear_modulus_gpa": 0.5}
    stated = scene.beam.model_dump(exclude_none=True) | {name: more[name] for name in more if name == key}
    surface = resolve(change_scene(scene, beam=stated))
    assert isinstance(surface.structure, Beam)
    prior = surface.prior(sensor_mm)
    nominal = NominalSurface(surface.structure, 0.0, sensor_mm, prior, 1.0, 0.0, "mm", None)
    departures = Departures(
        rigidity=1.3, gain=[1.1, 1.0, 0.9], fixity=(0.1, 0.0), position_offset_mm=[1.0, 0.0, 0.0], offset_mm=[0.0] * 3
    )
    for rigidity in (1.0, 1.3):
        changed = departures.model_copy(update={"rigidity": rigidity})
        curve = nominal.curve(nominal.vector_of(changed))
        beam = changed_beam(surface.structure, rigidity, (0.1, 0.0))
        expected = [1.1, 1.0, 0.9] * influence(beam, [81.0, 160.0, 320.0], curve.place_mm[:, 0])
        assert curve.influence == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.abs(expected).max())
