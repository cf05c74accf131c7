"""What `design-sensors challenge` plays: deflections and places of each case, against statics and the page."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.scene import change_scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.lab.challenge import contacts, drift, faults, ringing
from beamtouch_models.lab.challenge.challenge import challenge
from beamtouch_models.lab.challenge.judge import Outcome, judge
from beamtouch_models.lab.challenge.play import DrawnContacts, Play, SimulatedSurface
from beamtouch_models.runtime import ModelFile

PAGE = Path(__file__).parents[2] / "docs" / "challenge.md"
RATE_HZ, LOW_MM, HIGH_MM = 200, 1.0, 399.0
"""Readings and range of contacts of the bench."""


def drawn(surface: SimulatedSurface, draws: int = 6, seed: int = 3) -> DrawnContacts:
    return DrawnContacts.of(surface, draws, np.random.default_rng(seed))


def names_in(play: Play) -> list[str]:
    return list(dict.fromkeys(name for name, _ in play.rows))


def on_the_page(*headings: str) -> set[str]:
    """Return the cases that tables under some headings of the page have for the bench."""
    sections = [
        PAGE.read_text(encoding="utf-8").split(f"\n## {heading}\n")[1].split("\n## ")[0] for heading in headings
    ]
    rows = [line.split(" | ")[:2] for text in sections for line in text.splitlines() if line.startswith("| ")]
    return {name.removeprefix("| ") for name, figures in rows if figures.strip()} - {"| case", "case", "| ---", "---"}


HONEST = "One contact, honestly measured", "Lost readings", "A beam that rings", "Zeros that drift"


def test_the_bench_goes_through_the_cases_of_the_page(surface: SimulatedSurface) -> None:
    at = drawn(surface, 2)
    cases = [
        *contacts.honest_cases(surface), *drift.drift_cases(surface), *faults.error_cases(surface),
        *faults.fault_cases(), *contacts.lossy_cases(surface),
    ]  # fmt: skip
    names = [{name for case in cases if case.honest == honest for name in names_in(case.make(at))} for honest in (0, 1)]
    assert names == [on_the_page("Faults and other worlds"), on_the_page(*HONEST)]


def test_progress_counts_the_cases(bench_model: Path) -> None:
    told, numbers = list[tuple[str, float]](), list[int]()

    def spread(_task: Callable[[int], object], tasks: range) -> list[list[object]]:
        numbers.extend(tasks)
        return [[] for _ in tasks]

    def progress(text: str, share: float) -> None:
        told.append((text, share))

    rows = challenge(bench_model.read_bytes(), draws=2, seed=3, progress=progress, spread=spread)  # type: ignore[arg-type]
    count = len(numbers)
    assert (rows, numbers) == ([], list(range(count)))
    assert [text for text, _ in told] == [f"case {min(1 + done, count)} of {count}" for done in range(count + 1)]
    assert [share for _, share in told] == pytest.approx([done / count for done in range(count + 1)])


def test_a_touch_comes_between_two_readings_and_stays(surface: SimulatedSurface) -> None:
    at, before = drawn(surface), surface.look_back
    play = contacts.touched(at)
    assert play.deflection_mm.shape == (6, 2 * before, 4)
    assert not play.deflection_mm[:, :before].any()
    assert np.isnan(play.truth_mm[:, :before]).all()
    assert (play.deflection_mm[:, before:] == at.deflection_mm[:, None]).all()
    assert (play.truth_mm[:, before:] == at.place_mm[:, None]).all()
    assert play.rows == tuple((f"touch, reading {number}", before + number - 1) for number in (1, 2, 3))
    assert contacts.touched(at, least=before + 7).deflection_mm.shape[1] == 2 * before + 7


def test_a_contact_at_rest_is_judged_at_its_last_reading(surface: SimulatedSurface) -> None:
    at = drawn(surface)
    for least in (0, 9):
        play = contacts.rested(at, least=least)
        assert play.quiet
        assert play.rows == (("touch, settled", surface.look_back + least - 1),)
        assert play.deflection_mm.shape == (6, surface.look_back + least, 4)
        assert (play.deflection_mm == at.deflection_mm[:, None]).all()
        assert (play.truth_mm == at.place_mm[:, None]).all()


@pytest.mark.parametrize(("times", "end"), [(0.3, "smallest"), (0.9, "smallest"), (1.1, "largest"), (5.0, "largest")])
def test_a_force_beyond_the_range_bends_the_beam_in_proportion(
    surface: SimulatedSurface, times: float, end: str
) -> None:
    at = drawn(surface)
    play = contacts.pressed(at, times=times, force_n=7.0)
    assert play.deflection_mm[:, -1] == pytest.approx(at.deflection_mm * (times * 7 / at.force_n)[:, None])
    assert names_in(play) == [f"force {times:g} times the {end}"]


def test_forces_beyond_the_range_are_parts_of_its_ends(surface: SimulatedSurface) -> None:
    at = drawn(surface, 2)
    per_newton, forces = at.deflection_mm / at.force_n[:, None], {}
    for case in contacts.honest_cases(surface):
        if isinstance(case.make, partial) and case.make.func is contacts.pressed:
            play = case.make(at)
            forces[names_in(play)[0]] = float((play.deflection_mm[:, -1] / per_newton).mean())
    assert forces == pytest.approx({
        "force 0.3 times the smallest": 0.6, "force 1.1 times the largest": 22,
        "force 2 times the largest": 40, "force 5 times the largest": 100,
    })  # fmt: skip


@pytest.mark.parametrize(("missing", "words"), [(1, "one channel missing"), (2, "two channels missing")])
def test_any_channels_may_be_missing(surface: SimulatedSurface, missing: int, words: str) -> None:
    at = drawn(surface, 60)
    play = contacts.without(at, missing=missing)
    assert (play.errors.missing.sum(axis=1) == missing).all()
    assert play.errors.missing.any(axis=0).all()
    assert (play.errors.gain == at.honest.gain).all()
    assert names_in(play) == [words]


def test_channels_are_missing_only_while_enough_are_left(surface: SimulatedSurface) -> None:
    def missing(needed: int) -> list[int]:
        needing = replace(surface, metadata=surface.metadata.model_copy(update={"min_channels": needed}))
        makes = [case.make for case in contacts.honest_cases(needing)]
        return [one.keywords["missing"] for one in makes if isinstance(one, partial) and one.func is contacts.without]

    assert [missing(needed) for needed in (2, 3, 4)] == [[1, 2], [1], []]


@pytest.mark.parametrize(
    ("motion", "speed_mm_per_s", "readings"),
    [
        (contacts.BEGINS, 10.0, 40),
        (contacts.BEGINS, 990.0, 40),
        (contacts.BEGINS, 2000.0, 20),  # 199 of 398 mm
        (contacts.BEGINS, 9000.0, 5),  # one for each part
        (contacts.KEEPS, 10.0, 100),
        (contacts.KEEPS, 1000.0, 60),  # 298.5 mm
    ],
)
def test_a_load_moves_for_so_long_or_so_far(
    surface: SimulatedSurface, motion: contacts.Motion, speed_mm_per_s: float, readings: int
) -> None:
    assert motion.readings(surface, speed_mm_per_s) == readings
    assert motion.readings(surface, speed_mm_per_s, readings + 3) == readings + 3


def test_a_motion_must_fit_into_the_range(surface: SimulatedSurface) -> None:
    # Five readings at 200 Hz are 25 ms, in which 15920 mm/s are 398 mm.
    assert contacts.BEGINS.fits(surface, 15920.0)
    assert not contacts.BEGINS.fits(surface, 15921.0)
    assert contacts.KEEPS.fits(surface, 10.0, 7960)
    assert not contacts.KEEPS.fits(surface, 10.0, 7961)
    short = replace(surface, metadata=surface.metadata.model_copy(update={"ranges": surface.metadata.ranges.model_copy(
        update={"position_mm": (100.0, 120.0)})}))  # fmt: skip
    makes = [case.make for case in contacts.honest_cases(short)]
    fast = [one.keywords["speed_mm_per_s"] for one in makes if isinstance(one, partial) and one.func is contacts.moves]
    assert fast == [10, 30, 100, 300, 10, 30, 100, 300]  # 20 mm in five readings are 800 mm/s


@pytest.mark.parametrize(("motion", "first"), [(contacts.BEGINS, 0.2), (contacts.KEEPS, 0.6)])
def test_a_load_that_moves_has_lain_still_and_keeps_its_speed(
    surface: SimulatedSurface, motion: contacts.Motion, first: float
) -> None:
    at, before = drawn(surface, 40), surface.look_back
    play = contacts.moves(at, speed_mm_per_s=30.0, motion=motion)
    moving = motion.readings(surface, 30.0)
    steps = np.diff(play.truth_mm[..., 0], axis=1)
    assert steps.shape == (40, before + moving - 1)
    assert not steps[:, : before - 1].any()
    assert np.abs(steps[:, before - 1 :]) == pytest.approx(30 / RATE_HZ)
    assert {float(sign) for sign in np.sign(steps[:, -1])} == {-1.0, 1.0}
    assert (np.sign(steps[:, before - 1 :]) == np.sign(steps[:, -1:])).all()
    assert (play.truth_mm >= LOW_MM).all()
    assert (play.truth_mm <= HIGH_MM).all()
    judged = [reading for _, reading in play.rows]
    assert judged == [before + round(moving * (first + part * (1 - first) / 4)) - 1 for part in range(5)]
    assert names_in(play) == [f"{motion.name} at 30 mm/s"]
    # So slowly, the beam is where it is at rest; the force stays.
    still_mm = surface.under(play.truth_mm, at.force_n[:, None])
    np.testing.assert_allclose(play.deflection_mm, still_mm, atol=0.005)
    assert np.ptp(play.truth_mm[:, 0]) > 300  # anywhere on the beam


def test_a_load_crosses_a_support_if_it_has_been_on_both_sides(surface: SimulatedSurface) -> None:
    beam = surface.world.structure
    assert isinstance(beam, Beam)
    held = ({"at_mm": 0.0}, {"at_mm": 150.0}, {"at_mm": 400.0})
    without_mass = {"supports": list(held), "density_kg_m3": None}  # it has no inertia, which takes long to compute
    spans = Beam.model_validate({**beam.model_dump(), **without_mass})
    two_spans = replace(surface, world=replace(surface.world, structure=spans))
    play = contacts.moves(drawn(two_spans, 60), speed_mm_per_s=300.0)
    path = play.truth_mm[..., 0]
    expected = (path.min(axis=1) < 150) & (path.max(axis=1) > 150)
    assert play.crosses is not None
    assert play.crosses.tolist() == expected.tolist()
    assert 0 < expected.sum() < 60
    held_at_the_ends = contacts.moves(drawn(surface, 60), speed_mm_per_s=300.0).crosses
    assert held_at_the_ends is not None
    assert not held_at_the_ends.any()


@pytest.mark.parametrize(("since_s", "gap"), [(None, 5), (0.0, 1), (0.1, 20)])
def test_a_gap_is_judged_after_its_end(surface: SimulatedSurface, since_s: float | None, gap: int) -> None:
    at = drawn(surface, 3)
    play = contacts.interrupted(at, make=contacts.rested, when="in a test", gap=gap, since_s=since_s)
    assert play.lost is not None
    (begins,) = {int(number) for number in play.lost.argmax(axis=1)}
    assert play.lost[:, begins : begins + gap].all()
    assert (play.lost.sum(axis=1) == gap).all()
    assert [reading - (begins + gap) for _, reading in play.rows] == [0, 1, 2, 4, 9]
    assert names_in(play) == [f"gap of {gap} in a test"]
    assert not play.quiet
    length = play.deflection_mm.shape[1]
    if since_s is None:
        assert play.rows[-1][1] == length - 1
    else:
        assert begins == surface.look_back + since_s * RATE_HZ
    assert length >= surface.look_back + round((since_s or 0.0) * RATE_HZ) + gap + 10


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_readings_are_lost_at_random_but_none_that_is_judged(surface: SimulatedSurface, share: float) -> None:
    for make, name in ((contacts.touched, "touch"), (contacts.rested, "touch, settled")):
        play = contacts.lossy(drawn(surface, 20), make=make, share=share)
        assert play.lost is not None
        judged = [reading for _, reading in play.rows]
        assert not play.lost[:, judged].any()
        assert play.lost.mean() == pytest.approx(
            share, abs=5 * np.sqrt(share / play.lost.size) + 4 / play.lost.shape[1]
        )
        assert names_in(play) == [f"{name}, {share:.0%} lost"]


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


def test_a_play_at_one_rate_has_more_of_the_same_readings_at_another(surface: SimulatedSurface) -> None:
    """The state of a surface looks back at the window of its filter twice, and at a slow swing."""
    slow = replace(surface, slowest_period=surface.slowest_period + 3)
    assert slow.decided == surface.decided + 3
    assert slow.look_back == surface.look_back + 3
    assert surface.decided >= 2 * surface.metadata.filter.window + surface.slowest_period


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


def off_and_alike(at: DrawnContacts, play: Play) -> tuple[Floats, Floats]:
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


def test_nothing_is_said_of_readings_before_the_first_that_counts(bench: ModelFile, surface: SimulatedSurface) -> None:
    play = contacts.touched(drawn(surface, 2))
    readings = surface.world.readings(play.deflection_mm, play.errors, np.random.default_rng(4))
    first = play.rows[0][1] - 1
    heard = judge(surface, bench.run, readings, first)
    assert (heard.outcome[:, :first] == Outcome.NOTHING).all()
    assert (heard.outcome[:, first:] != Outcome.NOTHING).all()
