"""What `challenge` plays of zeros that drift, of faults and of loads that are not one contact, against statics."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.scene import change_scene
from beamtouch_models.lab.challenge import drift, faults
from beamtouch_models.lab.challenge.play import DrawnContacts, Play, SimulatedSurface
from models.bench_contacts import HIGH_MM, LOW_MM, RATE_HZ, drawn


@pytest.mark.parametrize("together", [True, False])
def test_zeros_drift_evenly_up_to_twice_the_stated_rate(surface: SimulatedSurface, together: bool) -> None:
    at = drawn(surface, 50)
    play = drift.drifts(at, together=together)
    before = surface.look_back
    assert surface.walk is not None
    drifted = play.deflection_mm - np.where(np.isnan(play.truth_mm), 0.0, at.deflection_mm[:, None])
    per_s = drifted[:, -1] * RATE_HZ / (play.deflection_mm.shape[1] - 1)
    np.testing.assert_allclose(drifted, per_s[:, None] * np.arange(drifted.shape[1])[:, None] / RATE_HZ, atol=1e-12)
    most = 2 * surface.walk.rate_mm_per_min / 60
    largest = np.abs(per_s).max(axis=1)
    assert 0.9 * most < largest.max() <= most
    assert largest.mean() == pytest.approx(most / 2, rel=0.25)  # evenly up to there
    assert (per_s.min() < 0) & (per_s.max() > 0)
    assert ((per_s != 0).sum(axis=1) == (4 if together else 1)).all()
    assert np.ptp(per_s, axis=1).max() < 1e-12 or not together
    # Ten seconds would be 2000 readings.
    assert [reading for _, reading in play.rows] == [before + 999, 2 * before + 999]
    assert play.deflection_mm.shape[1] == 2 * before + 1000
    assert np.isnan(play.truth_mm[..., 0]).sum(axis=1).tolist() == [2 * before] * 50


def test_a_slow_device_is_touched_for_ten_seconds_while_its_zeros_drift(surface: SimulatedSurface) -> None:
    def held(rate_hz: float) -> int:
        sensor = surface.metadata.sensor.model_copy(update={"rate_hz": rate_hz})
        slow = replace(surface, metadata=surface.metadata.model_copy(update={"sensor": sensor}))
        return int((~np.isnan(drift.drifts(drawn(slow, 2), together=True).truth_mm[0, :, 0])).sum())

    assert [held(rate_hz) for rate_hz in (60.0, 99.0, 120.0)] == [600, 990, 1000]
    assert held(0.5) == surface.look_back


def test_a_surface_whose_zeros_stay_has_no_case_of_drift(surface: SimulatedSurface) -> None:
    assert drift.drift_cases(replace(surface, walk=None)) == []


def off_and_alike(at: DrawnContacts, play: Play) -> tuple[Floats, Bools]:
    """Return what a play's sensors show beyond the contacts (draws, channels), and which channels do."""
    off = play.deflection_mm[:, -1] - at.deflection_mm
    return off, np.abs(off) > 1e-12


def test_faults_of_one_channel_leave_the_others_as_they_are(surface: SimulatedSurface) -> None:
    at, largest_mm = drawn(surface, 40), surface.metadata.max_deflection_mm
    stuck, is_off = off_and_alike(at, faults.stuck(drawn(surface, 40)))
    assert (is_off.sum(axis=1) == 1).all()
    assert is_off.any(axis=0).all()
    assert stuck[is_off] == pytest.approx(-at.deflection_mm[is_off])
    wedge, is_off = off_and_alike(at, faults.wedged(drawn(surface, 40), touched=True))
    assert (is_off.sum(axis=1) == 1).all()
    assert wedge[is_off] == pytest.approx(0.22 * largest_mm)
    alone = faults.wedged(drawn(surface, 40), touched=False)
    assert alone.deflection_mm[:, -1] == pytest.approx(wedge)
    assert alone.fault_mm == pytest.approx(wedge)
    assert np.isnan(alone.truth_mm).all()


@pytest.mark.parametrize("touched", [True, False])
def test_one_zero_drifts_either_way_by_ten_noises_beside_the_honest_errors(
    surface: SimulatedSurface, touched: bool
) -> None:
    at, noise_mm = drawn(surface, 40), surface.metadata.noise.reading_mm
    play = faults.drifted(drawn(surface, 40), touched=touched)
    off_mm = play.errors.zero_mm - at.honest.zero_mm
    assert np.sort(np.abs(off_mm), axis=1) == pytest.approx(np.tile([0, 0, 0, 10 * noise_mm], (40, 1)))
    assert {float(sign) for sign in np.sign(off_mm).ravel()} == {-1.0, 0.0, 1.0}
    assert (play.errors.gain == at.honest.gain).all()
    assert play.deflection_mm[:, -1] == pytest.approx(at.deflection_mm * touched)
    assert play.fault_mm == pytest.approx(at.deflection_mm * touched + off_mm)


def test_one_channel_is_ten_times_as_noisy(surface: SimulatedSurface) -> None:
    play = faults.noisy(drawn(surface, 40))
    assert np.sort(play.errors.noise, axis=1) == pytest.approx(np.tile([1, 1, 1, 10], (40, 1)))
    assert play.deflection_mm[:, -1] == pytest.approx(drawn(surface, 40).deflection_mm)


@pytest.mark.parametrize("times", [0.25, 1.0])
def test_a_pull_bends_the_beam_the_other_way(surface: SimulatedSurface, times: float) -> None:
    at = drawn(surface)
    expected = -at.deflection_mm * (2 * times / at.force_n)[:, None]
    assert faults.pulled(at, times=times).deflection_mm[:, -1] == pytest.approx(expected)


@pytest.mark.parametrize(("apart", "ratio"), [(0.5, 1.0), (0.5, 4.0), (0.05, 1.0)])
def test_two_contacts_share_the_force_and_lie_so_far_apart(
    surface: SimulatedSurface, apart: float, ratio: float
) -> None:
    """Only with this distance and these parts is there a pair of places that bends the beam so."""
    at = drawn(surface, 12)
    play = faults.two_contacts(at, apart=apart, ratio=ratio)
    first = np.linspace(LOW_MM, HIGH_MM - apart * 398, 3001)[:, None]
    near, far = (surface.under(place, np.ones(len(place))) for place in (first, first + apart * 398))
    nearest = []
    for seen, force in zip(play.deflection_mm[:, -1], at.force_n, strict=True):
        pairs = [(near + ratio * far) * force / (1 + ratio), (ratio * near + far) * force / (1 + ratio)]
        misses = [float(np.abs(pair - seen).max(axis=1).min() / seen.max()) for pair in pairs]
        assert min(misses) < 1e-3
        nearest.append(misses[0] < misses[1])
    assert ratio == 1 or len(set(nearest)) == 2  # either may be the stronger one


def test_two_contacts_at_the_quarters_have_8_newtons_each(surface: SimulatedSurface) -> None:
    play = faults.two_at_the_quarters(drawn(surface, 3))
    pair = surface.under(np.array([[100.5], [299.5]]), np.array([8.0, 8.0])).sum(axis=0)
    assert play.deflection_mm[:, -1] == pytest.approx(np.tile(pair, (3, 1)))


@pytest.mark.parametrize("part", [0.1, 0.5])
def test_a_load_is_spread_over_a_part_of_the_beam(surface: SimulatedSurface, part: float) -> None:
    at, width_mm = drawn(surface, 8), 400 * part
    play = faults.distributed(at, part=part)
    middles = np.linspace(LOW_MM + width_mm / 2, HIGH_MM - width_mm / 2, 1501)
    along = np.linspace(-width_mm / 2, width_mm / 2, 401)
    means = np.array([surface.world.influence(middle + along).mean(axis=0) for middle in middles])
    for seen, force in zip(play.deflection_mm[:, -1], at.force_n, strict=True):
        assert np.abs(means * force - seen).max(axis=1).min() < 2e-3 * seen.max()


@pytest.mark.parametrize("percent", [0.3, 3.0])
def test_gains_are_off_by_so_many_percent(surface: SimulatedSurface, percent: float) -> None:
    play = faults.gains_off(drawn(surface, 2000), percent=percent)
    assert (play.errors.gain - 1).std() == pytest.approx(percent / 100, rel=0.05)
    assert (play.errors.gain - 1).mean() == pytest.approx(0.0, abs=percent / 2000)
    assert play.fault_mm == pytest.approx(play.deflection_mm[:, 0] * play.errors.gain)


def test_zeros_are_off_by_so_many_noises(surface: SimulatedSurface) -> None:
    play = faults.zeros_off(drawn(surface, 2000), noises=3.0)
    assert play.errors.zero_mm.std() == pytest.approx(3 * surface.metadata.noise.reading_mm, rel=0.05)
    assert play.fault_mm == pytest.approx(play.deflection_mm[:, 0] + play.errors.zero_mm)


def test_sensors_are_off_their_places_by_a_millimetre(surface: SimulatedSurface) -> None:
    at, sensor_mm = drawn(surface, 150), surface.world.sensor_mm
    play = faults.places_off(at)
    # Maxwell: a beam bends at the sensor under a load at the contact as it does there under one at the sensor.
    moved = [replace(surface.world, sensor_mm=sensor_mm + off).influence(at.place_mm[:, 0]) for off in (-0.5, 0.5)]
    slope = (moved[1] - moved[0]) * at.force_n[:, None]
    off_mm = (play.deflection_mm[:, -1] - at.deflection_mm) / slope
    steep = np.abs(slope) > 0.3 * np.abs(slope).max()
    assert off_mm[steep].std() == pytest.approx(1.0, rel=0.15)


def test_errors_are_honest_as_far_as_the_model_states_them(surface: SimulatedSurface) -> None:
    def honest(**changed: object) -> list[bool]:
        return [case.honest for case in faults.error_cases(replace(surface, **changed))]  # type: ignore[arg-type]

    noise_mm, four = surface.metadata.noise.reading_mm, np.ones(4)
    tolerant = change_scene(surface.scene, sensors={"mounting_tolerance_mm": 1.0})
    strict = change_scene(surface.scene, sensors={"mounting_tolerance_mm": 0.9})
    nothing = {"gain": 0 * four, "zero_mm": 0 * four, "scene": strict}
    assert honest(**nothing) == [False] * 8
    assert honest(**nothing | {"gain": np.array([0.02, 0.01, 0.03, 0.04])}) == [True, True] + [False] * 6
    assert honest(**nothing | {"zero_mm": noise_mm * np.array([3.0, 5.0, 4.0, 9.0])}) == (
        [False] * 3 + [True] * 3 + [False] * 2
    )
    assert honest(**nothing | {"scene": tolerant}) == [False] * 7 + [True]
