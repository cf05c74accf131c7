"""The physics of plates, against series, published values, beams, springs, and elements of another program."""

import math

import mpmath
import numpy as np
import pytest
import skfem
from scipy.sparse.linalg import splu
from skfem.helpers import dd, ddot, trace

from beamtouch_models import SceneError
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics import beam
from beamtouch_models.design.physics import plate as module
from beamtouch_models.design.physics.motion import first_frequency_hz, sag_mm
from beamtouch_models.design.physics.plate import influence, supported_plate
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.plate import Plate

SENSORS = np.array([[100.0, 75.0], [200.0, 150.0], [350.0, 50.0]])
LOADS = np.array([[100.0, 75.0], [200.0, 225.0], [25.0, 275.0]])


def steel(**changed: float | str | list[dict[str, float]] | None) -> Plate:
    stated = {"length_x_mm": 400.0, "length_y_mm": 300.0, "thickness_mm": 3.0, "material": "steel"} | changed
    return Plate.model_validate(stated)


def simply_supported(plate: Plate, sensor: Floats, load: Floats) -> float:
    """Timoshenko & Woinowsky-Krieger, Theory of Plates and Shells, 1959, eq. 149: one sum of hyperbolic functions."""
    a, b = (mpmath.mpf(length) for length in plate.size_mm)
    (x, y), (xi, eta) = map(float, sensor), map(float, load)
    low, high = min(y, eta), max(y, eta)

    def term(m: mpmath.mpf) -> mpmath.mpf:
        beta = m * mpmath.pi * b / a
        above, below = beta * (b - high) / b, beta * low / b
        shape = 1 + beta * mpmath.coth(beta) - above * mpmath.coth(above) - below * mpmath.coth(below)
        waves = mpmath.sin(m * mpmath.pi * xi / a) * mpmath.sin(m * mpmath.pi * x / a)
        return shape * mpmath.sinh(below) * mpmath.sinh(above) / mpmath.sinh(beta) * waves / m**3

    total = mpmath.fsum(term(mpmath.mpf(m)) for m in range(1, 120))
    return float(a**2 / (mpmath.pi**3 * plate.rigidity_n_mm) * total)


def test_simply_supported_edges_bend_as_the_series_says() -> None:
    plate = steel(supports="edges")
    exact = np.array([[simply_supported(plate, sensor, load) for sensor in SENSORS] for load in LOADS])
    assert influence(plate, SENSORS, LOADS) == pytest.approx(exact, abs=3e-4 * exact.max())


def test_a_square_on_its_corners_bends_as_published() -> None:
    """Plates.md of D = a = 1 and nu = 0.3: under a uniform load at its centre and edge, under a load in the middle."""
    square = Plate(length_x_mm=100, length_y_mm=100, thickness_mm=1, youngs_modulus_gpa=210, poisson_ratio=0.3)
    at = np.array([[50.0, 50.0], [50.0, 0.0], [0.0, 50.0]])
    unit = square.rigidity_n_mm / 100**2
    everywhere = influence(square, at, [[50.0, 50.0]], width_mm=100.0)[0] * unit
    assert everywhere == pytest.approx([0.02551, 0.01775, 0.01775], rel=4e-4)
    assert influence(square, at, [[50.0, 50.0]])[0, 0] * unit == pytest.approx(0.03914, rel=2e-4)


@pytest.mark.parametrize("springs", [{}, {"support_stiffness_n_per_mm": 15.0}])
@pytest.mark.parametrize(
    "corners", [[(0, 0), (400, 0), (0, 300), (400, 300)], [(50, 50), (350, 25), (100, 275), (375, 250), (200, 150)]]
)
def test_supports_anywhere_are_those_of_another_program(
    springs: dict[str, float], corners: list[tuple[float, float]]
) -> None:
    supports = [{"x_mm": float(x), "y_mm": float(y)} for x, y in corners]
    plate = steel(supports=supports, **springs)
    stiffness, poisson = plate.rigidity_n_mm, plate.poisson

    def density(u: skfem.DiscreteField, v: skfem.DiscreteField, _: object) -> Floats:
        bent, other = dd(u), dd(v)
        energy: Floats = stiffness * ((1 - poisson) * ddot(bent, other) + poisson * trace(bent) * trace(other))
        return energy

    mesh = skfem.MeshQuad.init_tensor(np.linspace(0, 400, 33), np.linspace(0, 300, 25))
    basis = skfem.Basis(mesh, skfem.ElementQuadBFS(), intorder=6)
    sensors, loads, held = (basis.probes(np.asarray(at, dtype=float).T) for at in (SENSORS, LOADS, corners))
    spring = springs.get("support_stiffness_n_per_mm", 1e7)
    whole = skfem.BilinearForm(density).assemble(basis) + held.T @ held * spring
    theirs = loads @ splu(whole.tocsc()).solve(sensors.T.toarray())
    assert influence(plate, SENSORS, LOADS) == pytest.approx(theirs, abs=3e-4 * np.abs(theirs).max())


@pytest.mark.parametrize("lines", [(0.0, 400.0), (60.0, 330.0)])
def test_a_plate_that_bends_one_way_is_a_beam(lines: tuple[float, float]) -> None:
    """Without lateral contraction, a load over the whole width bends a plate as a beam, on its overhangs as well."""
    values = {"youngs_modulus_gpa": 70.0, "thickness_mm": 4.0}
    plate = Plate.model_validate(
        {"length_x_mm": 400.0, "length_y_mm": 20.0, "poisson_ratio": 0.0, "supports": [{"x_mm": x} for x in lines]}
        | values
    )
    supports = [{"at_mm": x} for x in lines]
    strip = Beam.model_validate({"length_mm": 400.0, "width_mm": 20.0, "supports": supports} | values)
    positions, loads = np.array([30.0, 110.0, 200.0, 390.0]), np.array([10.0, 100.0, 205.0, 395.0])
    across = np.column_stack([positions, [3.0, 10.0, 10.0, 17.0]]), np.column_stack([loads, np.full(4, 10.0)])
    wide = influence(plate, *across, width_mm=20.0)
    exact = beam.influence(strip, positions, loads, width_mm=20.0)
    # Within a width of 20 mm of the load's ends, the load at 395 mm is that of the part on the plate.
    assert wide == pytest.approx(exact, abs=4e-3 * np.abs(exact).max())


@pytest.mark.parametrize("stiffness", [1e-3, 15.0])
@pytest.mark.parametrize(("sides", "thickness"), [((400.0, 300.0), 50.0), ((2000.0, 100.0), 25.0)])
def test_a_stiff_plate_on_springs_sinks_and_tilts(
    stiffness: float, sides: tuple[float, float], thickness: float
) -> None:
    plate = steel(
        length_x_mm=sides[0], length_y_mm=sides[1], thickness_mm=thickness, support_stiffness_n_per_mm=stiffness
    )
    share = np.array([[0.0, 0.0], [0.3, 0.9], [1.0, 0.5]])
    rigid = (1 + (2 * share - 1) @ (2 * share - 1).T) / (4 * stiffness)
    bent = 0.15 * max(sides) ** 2 / plate.rigidity_n_mm * max(1.0, sides[0] / sides[1])
    assert influence(plate, share * sides, share * sides) == pytest.approx(rigid, abs=bent + 1e-9 * rigid.max())


@pytest.mark.parametrize(
    ("supports", "length", "thickness"),
    [
        ("corners", 20.0, 0.1),
        ("edges", 20.0, 5.0),
        ("corners", 300.0, 0.1),
        ("edges", 300.0, 50.0),
        ("corners", 8000.0, 50.0),
        ("edges", 8000.0, 0.1),
    ],
)
def test_influence_at_the_ends_of_its_range(supports: str, length: float, thickness: float) -> None:
    """Warnings are errors. What a load moves at a sensor, a load at the sensor moves at its place."""
    for stiffness in (1e-3, 1.0, 1e9, None):
        plate = steel(
            length_y_mm=length, thickness_mm=thickness, supports=supports, support_stiffness_n_per_mm=stiffness
        )
        places = np.random.default_rng(0).uniform(0, plate.size_mm, (7, 2))
        matrix = influence(plate, places, places)
        assert np.isfinite(matrix).all()
        assert matrix == pytest.approx(matrix.T, abs=1e-6 * matrix.max())
        assert np.diag(matrix).min() > 0
        one = influence(plate, places, places[2:3])  # fewer loads than sensors
        assert one[0] == pytest.approx(matrix[2], abs=1e-9 * matrix.max())


def test_stiff_springs_end_at_rigid_supports_and_soft_ones_add_up() -> None:
    rigid, stiff, soft, softer = (
        influence(steel(support_stiffness_n_per_mm=stiffness), SENSORS, LOADS) for stiffness in (None, 1e9, 0.3, 0.03)
    )
    assert stiff == pytest.approx(rigid, abs=1e-6 * rigid.max())
    share = [2 * places / (400.0, 300.0) - 1 for places in (LOADS, SENSORS)]
    bent, still_bent = (
        matrix - (1 + share[0] @ share[1].T) / (4 * stiffness) for matrix, stiffness in ((soft, 0.3), (softer, 0.03))
    )
    assert bent == pytest.approx(still_bent, abs=1e-2 * rigid.max())


def test_two_supports_at_nearly_one_place_share_the_load() -> None:
    twice = [(x, y) for x, y in [(0.0, 0.0), (400.0, 0.0), (0.0, 300.0), (400.0, 300.0)]]
    supports = [{"x_mm": x, "y_mm": y} for x, y in [*twice, (1e-9, 0.0)]]
    assert influence(steel(supports=supports), SENSORS, LOADS) == pytest.approx(
        influence(steel(), SENSORS, LOADS), rel=1e-6
    )


def test_a_contact_of_some_width_is_the_mean_over_its_part_of_the_plate() -> None:
    plate, width = steel(support_stiffness_n_per_mm=30.0), 44.0
    for place in ([200.0, 150.0], [390.0, 295.0]):
        low, high = np.maximum(np.array(place) - width / 2, 0), np.minimum(np.array(place) + width / 2, plate.size_mm)
        middles = [low[axis] + (np.arange(40) + 0.5) / 40 * (high - low)[axis] for axis in (0, 1)]
        points = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)
        mean = influence(plate, SENSORS, points).mean(axis=0)
        assert influence(plate, SENSORS, [place], width)[0] == pytest.approx(mean, rel=2e-5)
        point, small = (influence(plate, SENSORS, [place], narrow) for narrow in (0.0, 1e-7))
        assert small == pytest.approx(point, rel=1e-6)


def test_slopes_and_bends() -> None:
    """A rigid plate on springs slopes by its tilt and does not bend; on rigid corners all that moves is bending."""
    thick, at, load = steel(thickness_mm=50.0, support_stiffness_n_per_mm=2.0), SENSORS[:1], np.array([[300.0, 60.0]])
    tilt = (2 * load[0] / thick.size_mm - 1) * 2 / np.array(thick.size_mm) / (4 * 2.0)
    solved = supported_plate(thick)
    assert solved.slopes(at, load)[0, 0] == pytest.approx(tilt, rel=1e-2)
    assert abs(solved.bends(at, load)[0, 0]) < 1e-4 * solved.influence(at, load)[0, 0]
    thin = supported_plate(steel())
    assert thin.bends(SENSORS, LOADS) == pytest.approx(thin.influence(SENSORS, LOADS), rel=1e-9)


def test_what_is_kept_of_a_plate_stays_in_its_bound_and_changes_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """One load at a time, as nothing solved for others can help, beside all of them, and asked again."""
    solved, rng = supported_plate(steel(poisson_ratio=0.29, supports="edges")), np.random.default_rng(1)
    sets = [rng.uniform(5, 295, (count, 2)) for count in (40, 3, 17, 16)]
    alone = [np.concatenate([solved.influence(SENSORS, load[None]) for load in loads]) for loads in sets]
    unknowns = solved.body.rigid.shape[0]
    monkeypatch.setattr(module, "KEPT", 45 * unknowns)
    for loads, expected in [*zip(sets, alone, strict=True)] * 2:
        answer = solved.influence(loads, SENSORS).T
        assert answer == pytest.approx(expected, rel=1e-9)
        assert 0 < sum(kept.size for kept in solved.body.kept.values()) <= 45 * unknowns


def test_frequencies_are_those_published() -> None:
    """Blevins, Formulas for Natural Frequency and Mode Shape, 1979, table 11-4; Leissa, NASA SP-160, on its corners."""
    edges = steel(supports="edges")
    unit = math.sqrt(edges.rigidity_n_mm * 1e3 / (7850e-9 * 3.0))
    exact = math.pi / 2 * unit * (1 / 400**2 + 1 / 300**2)
    assert first_frequency_hz(edges) == pytest.approx(exact, rel=5e-3)
    square = steel(length_y_mm=400.0)
    assert first_frequency_hz(square) == pytest.approx(7.12 / (2 * math.pi) * unit / 400**2, rel=1e-2)
    springs = steel(thickness_mm=20.0, support_stiffness_n_per_mm=5.0)
    mass_kg = 7850e-9 * 400 * 300 * 20
    assert first_frequency_hz(springs) == pytest.approx(math.sqrt(4 * 5e3 / mass_kg) / (2 * math.pi), rel=5e-3)
    assert first_frequency_hz(Plate(length_x_mm=9, length_y_mm=9, thickness_mm=1, youngs_modulus_gpa=9)) is None


def test_sag_is_that_of_a_uniform_load() -> None:
    square = steel(length_y_mm=400.0)
    pressure = 7850e-9 * 3.0 * 9.80665
    assert sag_mm(square) == pytest.approx(0.02551 * pressure * 400**4 / square.rigidity_n_mm, rel=5e-3)


@pytest.mark.parametrize(
    ("places", "message"),
    [
        ([[10.0, 301.0]], "sensor_mm: 10, 301 lies off the plate, 0..400 by 0..300 mm"),
        ([[math.nan, 1.0]], "sensor_mm: nan, 1 lies off the plate"),
        ([10.0, 20.0], "sensor_mm: give places as a list of pairs, x and y in mm"),
        ([], "sensor_mm: give places as a list of pairs"),
    ],
)
def test_places_off_the_plate_are_refused(places: list[list[float]] | list[float], message: str) -> None:
    with pytest.raises(SceneError) as refused:
        influence(steel(), places, LOADS)
    assert str(refused.value).startswith(message)
