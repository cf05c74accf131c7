"""Temperature: the axial force in a held beam against textbooks, and the drift."""

import math

import numpy as np
import pytest

from beamtouch_models.design.physics.axial import held
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.pricing.effect import Effect
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.surface import resolve
from beamtouch_models.errors import SceneError
from support.surfaces.example_scenes import paper_scene

L_MM, EI = 400.0, 1.18125e7
PINNED = [{"at_mm": 0, "slides": False}, {"at_mm": L_MM, "slides": False}]
PROPPED = [{"at_mm": 0, "kind": "fixed"}, {"at_mm": L_MM, "slides": False}]
SLIDING = [{"at_mm": 0, "kind": "fixed"}, {"at_mm": L_MM, "kind": "fixed", "slides": True}]
WALLS = [{"at_mm": at, "kind": "fixed"} for at in (0, 200, 400)]


def beam(supports: object, **stated: object) -> Beam:
    """The paper's beam, of steel that lengthens by 12 um/(m K)."""
    plain = {"length_mm": L_MM, "material": "steel", "width_mm": 25, "thickness_mm": 3, "supports": supports}
    return Beam.model_validate(plain | stated)


def thicker_to(end_mm: float) -> list[dict[str, float]]:
    """Segments of which the first is twice as thick."""
    return [{"to_mm": end_mm, "thickness_mm": 6}, {"to_mm": L_MM, "thickness_mm": 3}]


HELD = [
    # N = E A alpha T: 210 GPa times 75 mm^2 times 12e-6 are 189 N/K. The lowest roots kl of sin, of tan kl = kl, and of
    # 1 - cos kl; Timoshenko & Gere, Theory of Elastic Stability, ch. 2.
    (beam(PINNED), 189.0, math.pi**2 * EI / L_MM**2),
    (beam(PROPPED), 189.0, 4.493409457909064**2 * EI / L_MM**2),
    (beam("fixed-fixed"), 189.0, 4 * math.pi**2 * EI / L_MM**2),
    # Left 378 N/K, right 189 N/K; the right half buckles first, alone.
    (beam(WALLS, segments=thicker_to(200)), 378.0, 4 * math.pi**2 * EI / 200**2),
]


def test_the_force_of_a_stepped_beam_is_that_of_its_sections_in_a_row() -> None:
    found = held(beam(PINNED, segments=thicker_to(100)))
    # 100 mm of 31.5 MN and 300 mm of 15.75 MN: 4.8e-3 mm/K over (100/31.5e6 + 300/15.75e6) mm/N.
    assert found is not None
    assert found.force_n_per_k == pytest.approx(12e-6 * 400 / (100 / 31.5e6 + 300 / 15.75e6), rel=1e-12)


@pytest.mark.parametrize(("stated", "force_n_per_k", "critical_n"), HELD)
def test_a_held_beam_bears_the_force_of_its_sections_and_buckles_as_euler_found(
    stated: Beam, force_n_per_k: float, critical_n: float
) -> None:
    found = held(stated)
    assert found is not None
    assert found.force_n_per_k == pytest.approx(force_n_per_k, rel=1e-12)
    assert found.buckles_k == pytest.approx(critical_n / 189, rel=1e-3)


@pytest.mark.parametrize("supports", ["simply-supported", "cantilever", "propped", SLIDING])
def test_a_beam_that_can_lengthen_bears_no_force(supports: object) -> None:
    assert held(beam(supports)) is None


@pytest.mark.parametrize("share", [-3.0, 0.5, 0.9])
def test_the_middle_of_a_pinned_beam_column_deflects_as_in_the_textbook(share: float) -> None:
    """Timoshenko & Gere, 1961, eq. 1-14: F l^3/(48 EI) times 3 (tan u - u)/u^3, with u = (pi/2) sqrt(N/N_cr)."""
    found = held(beam(PINNED))
    u = complex(math.pi / 2 * np.emath.sqrt(share))
    factor = (3 * (np.tan(u) - u) / u**3).real
    assert found is not None
    assert 1 + found.change(share * found.buckles_k) == pytest.approx(factor, rel=0.04)


def warmed(supports: object, range_k: tuple[float, float], **sensors: object) -> Scene:
    stated = paper_scene(count=4, noise_percent_of_max=0.2, zero_drift_mm=0.001).model_dump()
    stated["beam"] |= {"material": "steel", "supports": supports}
    stated["sensors"] |= sensors
    return Scene.model_validate({**stated, "environment": {"temperature_range_k": range_k}})


def priced(scene: Scene, name: str) -> Effect:
    (found,) = (effect for effect in resolve(scene).effects if effect.name == name)
    return found


def test_both_ends_of_the_range_are_priced() -> None:
    """A pinned beam 3 K warmer and 3 K colder: N/N_cr = 0.778 and -0.778."""
    warm, cold, both = (
        priced(warmed(PINNED, ends), "expansion").price for ends in ((0.0, 3.0), (-3.0, 0.0), (-3.0, 3.0))
    )
    assert warm is not None
    assert cold is not None
    assert both == warm > cold > 1
    # A sine of deflection is 1/(1 - N/N_cr) times as large; a point load in the middle is nearly one.
    share = 3 * 189 / (math.pi**2 * EI / L_MM**2)
    assert warm / cold == pytest.approx((share / (1 - share)) / (share / (1 + share)), rel=0.02)
    effect = priced(warmed(PINNED, (-3.0, 3.0)), "expansion")
    assert effect.verdict == "not modelled"
    assert "it buckles 3.86 K above its mounting" in effect.reason
    assert "buckling is near" in effect.reason


@pytest.mark.promise("docs/how-to/design.md", "a scene whose beam buckles is refused.")
def test_a_beam_that_buckles_is_refused() -> None:
    with pytest.raises(SceneError, match=r"temperature_range_k: 4 K above its mounting the beam buckles.* slide"):
        priced(warmed(PINNED, (-10.0, 4.0)), "expansion")
    assert priced(warmed("simply-supported", (-10.0, 40.0)), "expansion").price == 0


@pytest.mark.promise(
    "docs/reference/scene.md",
    "Largest drift of a sensor's zero with the temperature. It adds to `zero_drift_mm`.",
)
def test_the_drift_of_the_sensors_is_part_of_the_floor() -> None:
    """0.3 um/K over 20 K, between two temperatures anywhere in it: 6 um / sqrt(6), beside 1 um of other drift."""
    still, drifting = warmed("propped", (-5.0, 15.0)), warmed("propped", (-5.0, 15.0), drift_um_per_k=0.3)
    temperatures = np.random.default_rng(1).uniform(-5, 15, (2, 100_000))
    expected_mm = 0.3e-3 * float(np.std(temperatures[0] - temperatures[1]))
    assert resolve(drifting).readings.floor_mm == pytest.approx(math.hypot(0.001, expected_mm), rel=0.01)
    effect = priced(drifting, "sensor drift")
    assert effect.verdict == "floor"
    noise_mm = 0.002 * influence_peak_mm(drifting)
    assert effect.price == pytest.approx(expected_mm / noise_mm, rel=0.01)
    assert "up to 6 um after a tare" in effect.reason
    assert "2.4 times zero drift" in effect.reason
    prior = resolve(drifting).prior(np.array([100.0, 200.0]))
    assert prior.errors.zero_mm == pytest.approx(resolve(drifting).readings.floor_mm)
    assert resolve(still).readings.floor_mm == 0.001


def influence_peak_mm(scene: Scene) -> float:
    """Largest deflection: 10 N on the propped beam, Roark's table 8.1, case 1c: 0.0098 F l^3/EI at most."""
    places = np.linspace(0, L_MM, 401)
    return 10 * float(influence(scene.beam, places, places).max())
