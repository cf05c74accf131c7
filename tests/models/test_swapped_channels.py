"""Channels, ends and axes that a recording has swapped, and zeros that moved: on the paper's beam and on a plate."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.calibration.swapped import _from_own_zeros, _swaps, swapped
from beamtouch_models.design.physics.structure import influence_of
from beamtouch_models.runtime.error_model import Errors
from models.nominal_beam import NOISE_MM, loads_on, nominal_of
from models.scene_limits import PLATE, made

NAMES = ["s1", "s2", "s3", "s4"]
PERFECT = np.zeros(16)
CHECK = "; check the wiring and the order in the daemon's config"
OTHER_END, OTHER_CORNER = "the channels seem to be in reverse order, or", "the channels seem to be in another order, or"


@pytest.fixture(scope="module")
def nominal() -> NominalSurface:
    return nominal_of()


def weak(nominal: NominalSurface, strongest_n: float) -> Loads:
    """Return nine loads of up to this force."""
    loads = loads_on(nominal, PERFECT, 0, 9)
    force_n = loads.force_n / 17 * strongest_n
    clean = nominal.curve(PERFECT).measured_mm(loads.place_mm, force_n)
    noise_mm = loads.deviation_mm * np.random.default_rng(1).normal(size=clean.shape)
    return replace(loads, force_n=force_n, measured_mm=clean + noise_mm)


def test_a_wiring_that_changes_less_than_eight_noises_is_not_told(nominal: NominalSurface) -> None:
    """Under 0.7 N, the inverted sensor leaves residuals of 7.2 noises, far beyond what the loads state."""
    loads = weak(nominal, 0.7)
    assert swapped(nominal, replace(loads, measured_mm=loads.measured_mm * [1, 1, -1, 1]), NAMES) is None


def test_zeros_are_what_readings_have_where_nothing_is_expected(nominal: NominalSurface) -> None:
    """With gains that are off, and of a channel that lacks a load; without a change of the load, none is found."""
    loads = loads_on(nominal, PERFECT)
    clean = nominal.curve(PERFECT).measured_mm(loads.place_mm, loads.force_n)
    zeros, gains = np.array([0.05, -0.07, 0.0, 0.11]), np.array([1.1, 0.9, 1.0, 1.3])
    measured_mm = np.where(np.isfinite(loads.measured_mm), gains * clean + zeros, np.nan)
    found, corrected = _from_own_zeros(nominal, replace(loads, measured_mm=measured_mm))
    assert found == pytest.approx(zeros, abs=1e-9)
    assert corrected.measured_mm == pytest.approx(measured_mm - zeros, nan_ok=True)
    one = replace(loads[[3]], measured_mm=measured_mm[[3]])
    assert _from_own_zeros(nominal, one)[0].tolist() == [0.0] * 4


def swaps(nominal: NominalSurface, loads: Loads, names: list[str]) -> list[tuple[str, Loads]]:
    return list(_swaps(nominal, loads, names))


def test_each_pair_each_sensor_and_the_order_of_all_are_tried_and_the_other_end(nominal: NominalSurface) -> None:
    loads = loads_on(nominal, PERFECT)
    found = swaps(nominal, loads, NAMES)
    told = [message for message, _ in found]
    assert told[:6] == [
        f"{one} and {other} seem to be swapped{CHECK}"
        for one, other in (("s1", "s2"), ("s1", "s3"), ("s1", "s4"), ("s2", "s3"), ("s2", "s4"), ("s3", "s4"))
    ]
    assert told[6:10] == [f"{one} seems to be inverted{CHECK}" for one in NAMES]
    assert [message[: len(OTHER_END)] for message in told[10:]] == [OTHER_END] * 2
    orders: list[tuple[list[int], Floats]] = [([0, 3, 2, 1], np.ones(4)), ([0, 1, 2, 3], np.array([1, 1, 1, -1.0]))]
    for index, (order, signs) in zip((4, 9), orders, strict=True):
        corrected = found[index][1]
        assert corrected.measured_mm == pytest.approx(loads.measured_mm[:, order] * signs, nan_ok=True)
        assert corrected.deviation_mm == pytest.approx(loads.deviation_mm[:, order])
        assert corrected.place_mm is loads.place_mm
    reverse, mirrored = found[10][1], found[11][1]
    assert reverse.measured_mm == pytest.approx(loads.measured_mm[:, ::-1], nan_ok=True)
    assert mirrored.place_mm == pytest.approx(400 - loads.place_mm)
    assert mirrored.measured_mm is loads.measured_mm


def test_the_other_end_is_tried_if_all_loads_would_be_within_the_contacts(nominal: NominalSurface) -> None:
    """Contacts are at 1 to 399 mm: what stands at 0.5 mm stood there from the other end as well."""
    loads = loads_on(nominal, PERFECT)
    for place_mm, tries in ((1.0, 2), (399.0, 2), (0.5, 1), (399.5, 1)):
        at_mm = loads.place_mm.copy()
        at_mm[2] = place_mm
        told = [message for message, _ in swaps(nominal, replace(loads, place_mm=at_mm), NAMES)]
        assert sum(message.startswith(OTHER_END) for message in told) == tries


def test_on_a_plate_other_corners_and_exchanged_axes_are_tried() -> None:
    scene = made(PLATE)
    assert scene.plate is not None
    sensor_mm = np.array([[40.0, 70.0], [310.0, 50.0], [200.0, 255.0]])
    prior = Prior.of(influence_of(scene), sensor_mm, Errors(NOISE_MM))
    nominal = NominalSurface(scene.plate, 0.0, sensor_mm, prior, 1.3, 0.001, "mm", None)
    place_mm = np.array([[30.0, 50.0], [110.0, 220.0], [270.0, 130.0]])
    loads = Loads(
        np.arange(3), place_mm, np.full(3, 9.0), np.ones((3, 3)), np.ones((3, 3)), np.ones((3, 2), int), np.zeros(3)
    )
    found = swaps(nominal, loads, NAMES[:3])
    (exchanged,) = [one for message, one in found if message.startswith("the columns x_mm and y_mm seem")]
    assert exchanged.place_mm == pytest.approx(place_mm[:, ::-1])
    corners = [one.place_mm for message, one in found if message.startswith(OTHER_CORNER)]
    assert corners[-3] == pytest.approx(np.column_stack([place_mm[:, 0], 300 - place_mm[:, 1]]))
    assert corners[-2] == pytest.approx(np.column_stack([400 - place_mm[:, 0], place_mm[:, 1]]))
    assert corners[-1] == pytest.approx([400, 300] - place_mm)
    beyond = replace(loads, place_mm=np.array([[30.0, 50.0], [110.0, 220.0], [370.0, 130.0]]))
    assert not any(message.startswith("the columns x_mm") for message, _ in swaps(nominal, beyond, NAMES[:3]))
