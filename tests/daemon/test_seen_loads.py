"""A recorded load must be seen, must not move, and must not lift the beam; what is said if it does not."""

import numpy as np
import pytest

from beamtouch_daemon.commands.record import LoadRefusedError, _next_step, _require_still_and_seen
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.filters import FloatArray

from .surfaces import STEP_MM, surface_of

REST = 20_000
NOISE = surface_of(noise_mm=0.003)
WAVE = 20 * np.tile([1.0, -1.0], 100)
"""Noise of 0.002 mm, with a mean of 0."""


def readings(*deflections_mm: float | FloatArray) -> list[Reading]:
    """Return 200 readings of channels that deflect by so much under a load."""
    columns = [np.rint(REST + WAVE + np.asarray(one) / STEP_MM) for one in deflections_mm]
    return [Reading(0.0, tuple(row)) for row in np.column_stack(columns).tolist()]


def refusal(taken: list[Reading], surface: Surface = NOISE, **rest_gap_mm: float) -> str:
    with pytest.raises(LoadRefusedError) as raised:
        _require_still_and_seen(taken, surface, rest_gap_mm)
    return str(raised.value)


def test_a_load_is_seen_if_it_deflects_a_channel_by_three_times_the_noise_and_a_step() -> None:
    # Counts of this wave show a step of 40, which is 0.004 mm.
    for deflections in ((0.0132, 0.0), (0.0, 0.0132)):
        _require_still_and_seen(readings(*deflections), NOISE, {})
    assert refusal(readings(0.002, 0.0128)) == (
        "no load is seen: the largest deflection is 0.013 mm (s2), noise 0.003 mm"
    )
    assert refusal(readings(-0.0128, 0.002)) == (
        "no load is seen: the largest deflection is 0.013 mm (s1), noise 0.003 mm"
    )


def test_deflections_count_from_the_rest_gaps_of_the_tare() -> None:
    _require_still_and_seen(readings(0.0, 0.0), NOISE, {"s1": 2.52})
    assert refusal(readings(0.02, 0.0), s1=2.48).startswith("no load is seen")


def test_a_load_that_lifts_the_beam_is_refused_where_gaps_are_measured() -> None:
    assert refusal(readings(-0.05, 0.04)) == (
        "the largest deflection is negative: -0.05 mm (s1), against the load, which is right only where an overhang "
        "lifts"
    )
    _require_still_and_seen(readings(-0.04, 0.05), NOISE, {})
    field = surface_of(2, {"value_unit": "uT"}, noise_mm=0.003)
    _require_still_and_seen(readings(-0.05, 0.04), field, {})


def test_a_load_that_moves_while_it_is_recorded_is_refused() -> None:
    said = refusal(readings(0.05, np.repeat([0.05, 0.07], 100)))
    assert said == (
        "the load moved while it was recorded: s2, standard deviation 0.01 mm, drift 0.02 mm, noise 0.003 mm"
    )


def test_readings_that_are_not_good_are_left_out_and_two_must_be_left() -> None:
    taken = readings(0.05, 0.0)
    bad = [reading._replace(counts=(None, reading.counts[1])) for reading in taken]
    _require_still_and_seen([*bad[:50], *taken[50:]], NOISE, {})
    nothing = [reading._replace(counts=(None, 65_535.0)) for reading in taken]
    assert refusal(nothing) == "no channel gave good readings"
    assert refusal([*taken[:1], *nothing]) == "no channel gave good readings"
    assert refusal([]) == "no channel gave good readings"


def test_the_next_step_takes_the_recording_to_the_model_or_builds_one() -> None:
    calibrate = "design-sensors calibrate MODEL x.csv -o MODEL"
    assert _next_step("x.csv", "bench", surface_of(beam="0a1b2c3d4e5f")) == calibrate
    build = f"{calibrate}, or without a model design-sensors build --loads x.csv -o bench.onnx"
    assert _next_step("x.csv", "bench", surface_of()) == build
