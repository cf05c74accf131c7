"""Modes that readings do not show as swings: which they are, how much is hidden, and a rate that shows more.

The paper's beam: its modes are at k^2 times 43.9754 Hz, and k-th swings by 1/k^4 of the first (Blevins, table 8-1).
"""

import dataclasses
from math import log, pi

import numpy as np
import pytest

from beamtouch_models.design.pricing.aliases import Aliased, aliased_modes, at_rate, unseen_of, unseen_swing
from beamtouch_models.design.pricing.ringing import Ringing, decay_s, describe_ringing, ringing_mm, ringing_of
from beamtouch_models.design.scene import Scene, change_scene
from beamtouch_models.errors import SceneError
from support.surfaces.example_scenes import paper_scene

FIRST_HZ = 43.9754
FORCE_N, RIGIDITY, LENGTH_MM = 10.0, 210e3 * 25 * 3**3 / 12, 400.0
FIRST_MM = 2 * FORCE_N * LENGTH_MM**3 / (pi**4 * RIGIDITY)
"""Swing of the first mode: the first term of the deflection's series, 2 F l^3 / (pi^4 E I)."""


def scene_at(rate_hz: float, **beam: object) -> Scene:
    heavy = change_scene(paper_scene(rate_hz=rate_hz), beam={"density_kg_m3": 7850.0} | beam)
    return change_scene(heavy, contact={"position_mm": (0, 400)})


def test_a_mode_near_a_multiple_of_the_rate_seems_to_stand_still() -> None:
    """Read 88.5 times a second, the second mode of 175.9 Hz looks like one of 1.1 Hz, twice the rate away."""
    rate_hz, noise_mm = 88.5, 0.005
    aliased, _ = aliased_modes(scene_at(rate_hz), noise_mm)
    assert [mode.mode for mode in aliased] == [2]
    (second,) = aliased
    assert second.frequency_hz == pytest.approx(4 * FIRST_HZ, rel=1e-3)
    assert second.seen_hz == pytest.approx(2 * rate_hz - 4 * FIRST_HZ, rel=0.15)
    assert second.swing_mm == pytest.approx(FIRST_MM / 16, rel=1e-2)
    assert second.share == pytest.approx(1 / 16, rel=1e-2)
    falls_s = log(second.swing_mm / noise_mm) / (2 * pi * second.frequency_hz * 0.01)
    assert second.lasts_s == pytest.approx(falls_s, rel=1e-6)
    assert unseen_swing(scene_at(rate_hz), noise_mm) == pytest.approx(0.01 + 1 / 32, rel=1e-2)


def test_a_mode_is_shown_once_it_has_swung_for_a_part_of_a_period() -> None:
    """With little damping, the time of the first mode is that of the swing that readings see, and falls as it grows."""
    lasts = []
    for off_hz in (0.4, 0.8):
        aliased, _ = aliased_modes(scene_at(FIRST_HZ + off_hz, damping_ratio=1e-5), 0.05)
        first = aliased[0]
        assert (first.mode, first.share) == (1, 1.0)
        assert first.swing_mm == pytest.approx(FIRST_MM, rel=1e-2)
        lasts.append(first.lasts_s * first.seen_hz)
    assert lasts[0] == pytest.approx(lasts[1])
    assert 0.05 < lasts[0] < 1
    damped, _ = aliased_modes(scene_at(FIRST_HZ + 0.4, damping_ratio=0.2), 0.05)
    assert damped == ()  # it has fallen below the noise within a tenth of a second
    quiet, _ = aliased_modes(scene_at(FIRST_HZ + 0.4, damping_ratio=1e-5), 1.05 * FIRST_MM)
    assert quiet == ()


def test_without_a_mass_or_without_noise_nothing_is_aliased() -> None:
    assert aliased_modes(scene_at(88.5, density_kg_m3=None), 0.05) == ((), None)
    assert aliased_modes(scene_at(88.5), 0.0) == ((), None)
    assert aliased_modes(scene_at(1000.0), 0.05) == ((), None)


def test_a_better_rate_is_near_and_shows_more() -> None:
    scene = scene_at(FIRST_HZ * 1.01)
    _, better_hz = aliased_modes(scene, 0.01)
    assert better_hz is not None
    assert 0.69 < better_hz / scene.sensors.rate_hz < 1.41
    assert better_hz == float(f"{better_hz:.3g}")
    assert abs(better_hz / FIRST_HZ - 1) > 0.05
    assert unseen_swing(at_rate(scene, better_hz), 0.01) < 0.1 < unseen_swing(scene, 0.01)
    assert at_rate(scene, better_hz).sensors.rate_hz == better_hz
    assert at_rate(scene, better_hz).beam is scene.beam


def test_half_the_swing_of_aliased_modes_is_allowed_for_and_never_more_than_all() -> None:
    mode = Aliased(2, 100.0, 1.0, 0.5, 0.3, 2.0)
    assert unseen_of([]) == pytest.approx(0.01)
    assert unseen_of([mode, dataclasses.replace(mode, share=0.1)]) == pytest.approx(0.21)
    assert unseen_of([mode] * 9) == 1.0


FOUND = Ringing(
    frequency_hz=43.97, laden_frequency_hz=10.23, damping_ratio=0.015, after_touch_s=9.694, after_lift_s=2.249,
    damping_is_assumed=False, aliased=(), better_rate_hz=None, unseen_swing=0.01, better_unseen_swing=None,
)  # fmt: skip


def test_ringing_is_told_in_words() -> None:
    lines = describe_ringing(FOUND, "plate")
    assert lines[:2] == [
        "the plate rings at 44 Hz, with the largest force lying on it as a weight at 10.2 Hz; "
        "damping 1.5 % of critical",
        "after a touch it rings for up to 9.7 s, after a lift for up to 2.2 s, "
        "until the ringing is under the noise of a reading",
    ]
    assert len(lines) == 3
    assumed = describe_ringing(dataclasses.replace(FOUND, damping_is_assumed=True), "beam")[0]
    assert assumed.endswith(
        "damping 1.5 % of critical (assumed; with a tenth of it, it rings ten times as long: measure it, and state "
        "beam.damping_ratio)"
    )


def test_modes_that_stand_still_are_told_with_what_they_cost_and_a_better_rate() -> None:
    mode = Aliased(3, 395.78, 0.8765, 0.01234, 0.3, 2.345)
    costly = dataclasses.replace(FOUND, aliased=(mode,), unseen_swing=0.16)
    told = (
        "mode 3, of 396 Hz, looks like 0.88 Hz to the readings: for up to 2.3 s after a sudden force its swing, up to "
        "0.012 mm, is taken for deflection"
    )
    cost = "while the beam rings, intervals therefore allow for 16 % of its swing"
    assert describe_ringing(costly, "beam")[3:] == [told, cost]
    better = dataclasses.replace(costly, better_rate_hz=187.5, better_unseen_swing=0.023)
    rates = "at 187.5 readings a second, less seems to stand still: 2.3 % of the swing"
    assert describe_ringing(better, "beam")[3:] == [told, cost, rates]


def test_a_scene_rings_from_its_largest_deflection_down_to_the_noise() -> None:
    assert ringing_of(scene_at(200.0, density_kg_m3=None), 0.01, 1.0) is None
    found = ringing_of(scene_at(FIRST_HZ * 1.01, damping_ratio=0.03), 0.01, 1.13)
    assert found is not None
    assert found.frequency_hz == pytest.approx(FIRST_HZ, rel=1e-4)
    assert (found.damping_ratio, found.damping_is_assumed) == (0.03, False)
    assert found.after_lift_s == pytest.approx(log(113) / (0.03 * 2 * pi * FIRST_HZ), rel=1e-3)
    assert found.after_touch_s == pytest.approx(found.after_lift_s * FIRST_HZ / found.laden_frequency_hz, rel=1e-3)
    assert found.better_rate_hz is not None
    assert found.better_unseen_swing == unseen_swing(
        at_rate(scene_at(FIRST_HZ, damping_ratio=0.03), found.better_rate_hz), 0.01
    )
    assert found.unseen_swing == unseen_of(found.aliased) > found.better_unseen_swing
    quiet = ringing_of(scene_at(1000.0), 0.05, 1.13)
    assert quiet is not None
    assert (quiet.damping_is_assumed, quiet.better_rate_hz, quiet.better_unseen_swing) == (True, None, None)


def test_a_swing_that_begins_below_the_noise_rings_for_no_time() -> None:
    assert decay_s(0.5, 10.0, 0.1) == decay_s(1.0, 10.0, 0.1) == 0.0
    assert decay_s(1.001, 10.0, 0.6) == pytest.approx(log(1.001 / 0.8) / (0.6 * 20 * pi))


def test_a_sudden_load_swings_about_its_deflection_in_the_first_mode() -> None:
    """After half a period it is nearly twice as far, after a whole one hardly; both scale with the deflection."""
    half_s = 1 / (2 * FIRST_HZ)
    moved = ringing_mm(scene_at(200.0), [0.5, -2.0], [0.0, half_s, 2 * half_s, 100.0], damping_ratio=0.02)
    fall = np.exp(-0.02 * pi)
    assert moved[:, 0] == pytest.approx([0.0, 0.5 * (1 + fall), 0.5 * (1 - fall**2), 0.5], abs=1e-3)
    assert moved[:, 1] == pytest.approx(-4 * moved[:, 0])
    assumed = ringing_mm(scene_at(200.0), [1.0], [half_s])
    assert assumed[0, 0] == pytest.approx(1 + np.exp(-0.01 * pi), abs=1e-3)
    for ratio in (0.0, 1.0):
        with pytest.raises(SceneError, match=rf"^damping_ratio = {ratio:g} must be more than 0 and less than 1$"):
            ringing_mm(scene_at(200.0), [1.0], [0.1], damping_ratio=ratio)
    with pytest.raises(SceneError, match="static_mm"):
        ringing_mm(scene_at(200.0), [-1.1e9], [0.1])
    with pytest.raises(SceneError, match="time_s"):
        ringing_mm(scene_at(200.0), [1.0], [-0.1])
