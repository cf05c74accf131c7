"""What `challenge` plays of a beam that rings: when loads come and go, how it swings, and when it is judged."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.lab.challenge import ringing
from beamtouch_models.lab.challenge.play import DrawnContacts, Play, SimulatedSurface
from models.bench_contacts import RATE_HZ, drawn, names_in

DAMPED = 0.9
"""A damping ratio with which swings end within a reading or two."""


@pytest.fixture(scope="module")
def damped(surface: SimulatedSurface) -> SimulatedSurface:
    """The surface of the bench without noteworthy ringing, so that a play shows its loads."""
    beam = surface.world.structure
    assert isinstance(beam, Beam)
    structure = beam.model_copy(update={"damping_ratio": DAMPED})
    return replace(surface, world=replace(surface.world, structure=structure))


def first_touched(play: Play) -> set[int]:
    return {int(number) for number in (~np.isnan(play.truth_mm[..., 0])).argmax(axis=1)}


def loads_n(at: DrawnContacts, play: Play) -> Floats:
    """Return the forces (draws, readings) at the places of contacts that would bend a beam so at rest."""
    shape = at.deflection_mm / at.force_n[:, None]
    forces: Floats = (play.deflection_mm * shape[:, None]).sum(axis=2) / (shape**2).sum(axis=1)[:, None]
    return forces


def test_a_sudden_force_is_judged_at_its_times_and_a_growing_one_grows_evenly(damped: SimulatedSurface) -> None:
    at, before = drawn(damped), damped.look_back
    sudden, growing = ringing.rings(at), ringing.rings(at, lasting_s=0.1)
    for play in (sudden, growing):
        assert first_touched(play) == {before}
        since_ms = [(reading - before + 0.5) / RATE_HZ * 1e3 for _, reading in play.rows]
        assert since_ms == pytest.approx(ringing.SINCE_MS, abs=0.5 / RATE_HZ * 1e3)
        assert play.rows[-1][1] == play.deflection_mm.shape[1] - 1
        assert not play.deflection_mm[:, :before].any()
        assert not play.again
        assert loads_n(at, play)[:, -1] == pytest.approx(at.force_n, rel=1e-3)
    part = loads_n(at, growing) / at.force_n[:, None]
    # It is there after twenty readings, and in between it grows by a twentieth of itself with each.
    assert part[:, before + 21 :] == pytest.approx(1.0, abs=0.02)
    assert np.diff(part[:, before + 5 : before + 18], axis=1) == pytest.approx(0.05, abs=0.003)
    assert (loads_n(at, sudden)[:, before + 5 :] / at.force_n[:, None]) == pytest.approx(1.0, abs=0.02)
    assert ringing.rings(at, least=150).deflection_mm.shape[1] == before + 150


def test_a_beam_rings_with_the_damping_of_the_case_and_a_weight_more_slowly(surface: SimulatedSurface) -> None:
    at, before = drawn(surface, 20), surface.look_back

    def swing(**how: float | bool) -> Floats:
        """Return the load that swings show beyond the one at rest, over it."""
        forces = loads_n(at, ringing.rings(at, **how))  # type: ignore[arg-type]
        beyond: Floats = forces[:, before:] / at.force_n[:, None] - 1
        return beyond

    # The first mode holds nearly all of it: exp(-zeta omega t), 1 % by default.
    late = {zeta: np.sqrt((swing(damping_ratio=zeta)[:, 60:] ** 2).mean()) for zeta in (0.001, 0.05)}
    assert late[0.001] > 0.5
    assert late[0.05] < 0.01
    assert late[0.05] < np.sqrt((swing()[:, 60:] ** 2).mean()) < late[0.001]
    assert np.abs(swing()).max() > 0.9  # up to twice the deflection at rest
    names = [
        (partial(ringing.rings, at, weighs=True), "weight laid on"),
        (partial(ringing.rings, at, lasting_s=0.03), "force in 30 ms"),
        (partial(ringing.rings, at, jitter_s=2e-4), "sudden force, jitter 0.2 ms"),
        (partial(ringing.rings, at, damping_ratio=0.05), "sudden force, damping 5.0%"),
    ]
    for make, name in names:
        assert names_in(make()) == [f"{name}, {ms} ms" for ms in (20, 50, 100, 200, 500)]


def test_jitter_moves_the_times_of_readings_by_so_much(damped: SimulatedSurface) -> None:
    """The force grows in a second, so that the time of a reading can be told from it."""
    at = drawn(damped, 60)
    part = loads_n(at, ringing.rings(at, lasting_s=1.0, jitter_s=1e-3)) / at.force_n[:, None]
    steps_s = np.diff(part[:, damped.look_back + 20 :], axis=1)  # of a period, and of two deviations
    assert steps_s.mean() == pytest.approx(1 / RATE_HZ, rel=0.02)
    assert steps_s.std() == pytest.approx(np.sqrt(2) * 1e-3, rel=0.05)


@pytest.mark.parametrize("after_s", [0.3, 0.7])
def test_a_second_touch_comes_so_long_after_the_lift_of_the_first(damped: SimulatedSurface, after_s: float) -> None:
    at, before, apart = drawn(damped), damped.look_back, round(after_s * RATE_HZ)
    play = ringing.touches_again(at, after_s=after_s)
    assert play.again
    assert play.rows[0][0] == f"sudden force {after_s:g} s after a lift, 20 ms"
    first = play.deflection_mm[:, :before]
    assert (first == first[:, :1]).all()
    assert (first[:, 0] > 0).any(axis=1).all()
    assert np.abs(play.deflection_mm[:, before + 5 : before + apart]).max() < 0.02 * first.max()
    assert play.deflection_mm[:, -1] == pytest.approx(at.deflection_mm, rel=1e-3)
    # The place is that of the first until the filter has had its time, then none, then that of the second.
    settling = damped.metadata.filter.settling_ms * 1e-3 * RATE_HZ
    there = ~np.isnan(play.truth_mm[..., 0])
    held = there[:, : before + apart].sum(axis=1)
    assert ((held >= before + settling - 1) & (held <= before + settling + 1)).all()
    assert there[:, before + apart :].all()
    assert (play.truth_mm[:, before + apart :] == at.place_mm[:, None]).all()
    bent = damped.under(play.truth_mm[:, 0], np.ones(at.draws))
    assert (bent / np.linalg.norm(bent, axis=1, keepdims=True)) == pytest.approx(
        first[:, 0] / np.linalg.norm(first[:, 0], axis=1, keepdims=True)
    )


def test_a_tap_has_five_times_the_force_and_is_over_after_4_ms(damped: SimulatedSurface) -> None:
    fast = replace(damped, metadata=damped.metadata.model_copy(
        update={"sensor": damped.metadata.sensor.model_copy(update={"rate_hz": 20_000.0})}))  # fmt: skip
    at, before = drawn(fast, 2), fast.look_back
    play = ringing.taps(at)
    (since,) = first_touched(play)
    assert since == before
    assert play.again
    told = (~np.isnan(play.truth_mm[..., 0])).sum(axis=1)
    readings = (0.004 + fast.metadata.filter.settling_ms * 1e-3) * 20_000
    assert np.abs(told - readings).max() <= 1
    part = loads_n(at, play) / at.force_n[:, None]
    assert not part[:, :before].any()
    # As of a force five times as large, until it ends: then the swing of one that acts the other way is added.
    alike = ringing.rings(replace(at, rng=np.random.default_rng(11), force_n=5 * at.force_n))
    same = ringing.taps(replace(at, rng=np.random.default_rng(11)))
    during, after = slice(before, before + 79), slice(before + 82, None)
    np.testing.assert_allclose(same.deflection_mm[:, during], alike.deflection_mm[:, during])
    assert np.abs(part[:, after]).max() < np.abs(5 * part[:, during]).max()
    assert np.abs(same.deflection_mm[:, -1]).max() < 1e-6


def test_a_lift_leaves_the_beam_untouched_once_the_filter_has_had_its_time(damped: SimulatedSurface) -> None:
    at, before = drawn(damped), damped.look_back
    play = ringing.lifts(at)
    np.testing.assert_allclose(play.deflection_mm[:, :before], np.repeat(at.deflection_mm[:, None], before, axis=1))
    assert np.abs(play.deflection_mm[:, before + 5 :]).max() < 0.02 * at.deflection_mm.max()
    told = (~np.isnan(play.truth_mm[..., 0])).sum(axis=1) - before
    assert np.abs(told - damped.metadata.filter.settling_ms * 1e-3 * RATE_HZ).max() <= 1
    assert play.rows[0][0] == "after a lift, 20 ms"
