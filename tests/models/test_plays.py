"""What `design-sensors challenge` plays: deflections and places of each case, against statics and the page."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.lab.challenge import contacts, drift, faults
from beamtouch_models.lab.challenge.challenge import challenge
from beamtouch_models.lab.challenge.judge import Outcome, judge
from beamtouch_models.lab.challenge.play import SimulatedSurface
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.departures import Calibration, Departures
from models.bench_contacts import HIGH_MM, LOW_MM, RATE_HZ, drawn, names_in

PAGE = Path(__file__).parents[2] / "docs" / "challenge.md"


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


def test_gaps_come_with_the_change_of_load_or_a_tenth_of_a_second_later_or_while_a_load_moves_at_100_mm_per_s(
    surface: SimulatedSurface,
) -> None:
    makes = [case.make for case in contacts.lossy_cases(surface)]
    gaps = [one.keywords for one in makes if isinstance(one, partial) and one.func is contacts.interrupted]
    since_s = {(one["when"], one.get("since_s")) for one in gaps}
    assert since_s == {
        ("at rest", None), ("at a touch", 0.0), ("at a sudden force", 0.0), ("while it rings", 0.1),
        ("while the load moves", None),
    }  # fmt: skip
    moving = [one["make"].keywords for one in gaps if one["when"] == "while the load moves"]
    assert moving == [{"speed_mm_per_s": 100.0, "motion": contacts.KEEPS}] * 3


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


def test_a_surface_looks_back_at_two_windows_of_its_filter_and_at_a_whole_swing(surface: SimulatedSurface) -> None:
    def decided(period: float, more: int = 0) -> int:
        chosen = surface.metadata.filter
        filtered = chosen.model_copy(update={"window": chosen.window + more})
        metadata = surface.metadata.model_copy(update={"filter": filtered})
        return replace(surface, metadata=metadata, slowest_period=period).decided

    still = decided(0.0)
    assert [decided(period) - still for period in (0.2, 1.0, 12.5, 30.0)] == [1, 1, 13, 30]
    assert [decided(0.0, more) - still for more in (1, 5)] == [2, 10]
    assert still > 2 * surface.metadata.filter.window
    assert surface.look_back == surface.decided + surface.metadata.filter.max_readings


def test_nothing_is_said_of_readings_before_the_first_that_counts(bench: ModelFile, surface: SimulatedSurface) -> None:
    play = contacts.touched(drawn(surface, 2))
    readings = surface.world.readings(play.deflection_mm, play.errors, np.random.default_rng(4))
    first = play.rows[0][1] - 1
    heard = judge(surface, bench.run, readings, first)
    assert (heard.outcome[:, :first] == Outcome.NOTHING).all()
    assert (heard.outcome[:, first:] != Outcome.NOTHING).all()


def test_the_steps_of_the_adc_are_no_part_of_the_noise_before_it(bench: ModelFile) -> None:
    """A step q adds q^2 / 12 to the variance of a reading."""
    metadata, reading_mm = bench.metadata, bench.metadata.noise.reading_mm
    for step, noise in ((6**0.5, 0.5**0.5), (3**0.5, 0.75**0.5), (4.0, 0.0)):
        sensor = metadata.sensor.model_copy(update={"gain_mm_per_count": step * reading_mm})
        coarse = SimulatedSurface.of(metadata.model_copy(update={"sensor": sensor}))
        assert coarse.world.noise_mm == pytest.approx(noise * reading_mm, abs=1e-9)


def test_honest_errors_are_as_large_as_the_scene_states_or_the_calibration_left(
    bench: ModelFile, surface: SimulatedSurface
) -> None:
    errors = surface.honest(4000, np.random.default_rng(2))
    assert errors.gain.std(axis=0) == pytest.approx(np.full(4, 0.003), rel=0.06)
    assert errors.gain.mean(axis=0) == pytest.approx(np.ones(4), abs=3e-4)
    assert errors.zero_mm.std(axis=0) == pytest.approx(np.full(4, 0.001), rel=0.06)
    assert (errors.noise == 1).all()
    assert not errors.missing.any()
    gains, zeros_mm = [0.001, 0.002, 0.004, 0.008], [0.01, 0.02, 0.03, 0.04]
    floor = bench.metadata.floor.model_copy(update={"gain": gains, "zero_mm": zeros_mm})
    departures = Departures.none(4)
    fit = Calibration(departures=departures, fitted=["gain"], loads=9, residual_mm=0.0)
    calibrated = SimulatedSurface.of(bench.metadata.model_copy(update={"floor": floor, "calibration": fit}))
    assert (calibrated.gain.tolist(), calibrated.zero_mm.tolist()) == (gains, zeros_mm)
