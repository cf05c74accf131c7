"""Devices that give fractional numbers: mm, V, mA or inches, with steps that no type states."""

import json
import math
from pathlib import Path
from random import Random

import numpy as np
import pytest

from beamtouch_daemon.commands.noise import Measurement, Recording, report
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.at_rest import NotAtRestError, rest_gaps, select_rest
from beamtouch_daemon.measuring.noise import Keys, keys_of, measure_noise
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.processing.stuck import longest_runs
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.filters import FloatArray
from beamtouch_service.samples import Quality
from support.surfaces import configs

from .devices import pymodbus_server
from .floats import measures, registers_of, surface
from .process import command
from .recording import rows_of, talk
from .surfaces import CHANNELS, MINUTE, NOISE_MM, RATE_HZ, autoregressive, mean_of, surface_of

MM = {"type": "f32", "gain_mm_per_count": 1.0, "offset_mm": 0.0}
"""A device that gives the gap in mm."""
NOISE = f"noise_mm = {NOISE_MM}"
TARED = round(RATE_HZ)
"""Readings of a tare."""
WHITE = NOISE_MM * autoregressive(0.0)
LAST_DIGIT = np.spacing(np.float32(2.5)) * np.random.default_rng(2).integers(0, 2, (MINUTE, CHANNELS))
"""What the arithmetic of a device makes of a sensor that is frozen."""


def gauges(noise_mm: float | None = NOISE_MM, **channel: object) -> Surface:
    return surface_of(CHANNELS, MM | channel, filter=mean_of(20), noise_mm=noise_mm)


def gaps(deviation_mm: FloatArray | float, step_mm: float = 0.0) -> FloatArray:
    """Return gaps of 2.5 mm with deviations, shape (readings, channels), in steps and as 32 bits hold them."""
    values = 2.5 + np.broadcast_to(deviation_mm, (MINUTE, CHANNELS))
    shown = np.rint(values / step_mm) * step_mm if step_mm else values
    rounded: FloatArray = shown.astype(np.float32).astype(np.float64)
    return rounded


@pytest.mark.anyio
async def test_check_shows_a_light_load_in_whatever_unit_a_device_gives(tmp_path: Path) -> None:
    units = {  # gain and offset in mm, and the values at rest and under a load
        "mm": (1.0, 0.0, (2.5, 2.2)),
        "inch": (25.4, 0.0, (2.5 / 25.4, 2.2 / 25.4)),
        "volt": (0.3, 1.0, (5.0, 4.0)),
        "milliampere": (0.1875, 0.25, (12.0, 10.4)),
        "turned": (-1.0, 0.0, (-2.5, -2.2)),
        "picometre": (1e-9, 0.0, (2.5e9, 2.2e9)),
    }
    async with pymodbus_server(registers_of([value for _, _, pair in units.values() for value in pair])) as port:
        tables = [
            surface(port, name=name, first=4 * index, gain=gain, offset_mm=offset_mm)
            for index, (name, (gain, offset_mm, _)) in enumerate(units.items())
        ]
        noisy = surface(port, name="noisy", more="noise_mm = 0.003")
        outcome = await command("check", configs.write(tmp_path, *tables, noisy), "--json")
    assert outcome.code == 0, outcome.err
    stated = json.loads(outcome.out)["surfaces"]
    for name in units:
        deflections = [channel["deflection_mm"] for channel in stated[name]["channels"]]
        assert deflections == pytest.approx([0, 0.3], abs=2e-6), name
    assert [channel["deflection_mm"] for channel in stated["noisy"]["channels"]] == [0, 0.3]  # no more than it resolves


@pytest.mark.anyio
@pytest.mark.parametrize("order", ["ABCD", "CDAB", "BADC", "DCBA"])
async def test_values_of_every_type_are_read_in_every_order_of_their_registers(tmp_path: Path, order: str) -> None:
    value_types = ("u32", "i32", "f32", "f64")
    values = {"u32": (2500, 2200), "i32": (2500, 2200)}
    registers = [word for one in value_types for word in registers_of(values.get(one, (2.5, 2.2)), one, order)]
    async with pymodbus_server(registers) as port:
        tables = []
        for first, value_type in zip((0, 4, 8, 12), value_types, strict=True):
            gain = 0.001 if value_type in values else 1.0
            text = surface(port, value_type, name=value_type, first=first, gain=gain)
            tables.append(text.replace("port =", f'byte_order = "{order}"\nport =', 1))
        outcome = await command("check", configs.write(tmp_path, *tables))
    assert outcome.code == 0, outcome.err
    found = [line.split()[3:] for line in outcome.out.splitlines() if line.endswith("good")]
    assert [(float(gap), float(deflection), quality) for gap, deflection, quality in found] == [
        (2.5, 0.0, "good"),
        (2.2, 0.3, "good"),
    ] * 4


@pytest.mark.promise("docs/how-to/adc-module.md", "`check` says so if the values make sense only then.")
@pytest.mark.anyio
@pytest.mark.parametrize("order", ["ABCD", "CDAB", "BADC", "DCBA"])
async def test_check_names_the_byte_order_with_which_values_would_be_gaps(tmp_path: Path, order: str) -> None:
    async with pymodbus_server(registers_of((2.5037, 2.2011), "f32", order)) as port:
        said = []
        for configured in ("ABCD", "CDAB", "BADC", "DCBA"):
            text = surface(port).replace("port =", f'byte_order = "{configured}"\nport =', 1)
            outcome = await command("check", configs.write(tmp_path, text))
            hint = f'bench: with byte_order = "{order}" the values would be good; correct byte_order of the source'
            said.append((outcome.code, hint in outcome.err, "byte_order =" in outcome.err))
    assert sorted(said) == [(0, False, False)] + [(1, True, True)] * 3


@pytest.mark.anyio
async def test_values_that_stand_for_none_are_missing_and_zero_has_no_sign(tmp_path: Path) -> None:
    strange = (math.nan, math.inf, -math.inf, float(np.finfo(np.float32).max), -0.0, 2.5)
    async with pymodbus_server(registers_of(strange)) as port:
        tables = [surface(port, name=f"pair{first}", first=first) for first in (0, 4, 8)]
        outcome = await command("check", configs.write(tmp_path, *tables))
    assert outcome.code == 1
    rows = [line.split()[2:] for line in outcome.out.splitlines()[1:7]]
    assert rows[:3] == [["-", "-", "-", "missing"]] * 3
    assert rows[3] == ["3.402823e+38", "-", "-", "missing"]
    assert rows[4][:2] == ["0", "0.000000"]
    assert rows[5][-1] == "good"
    assert "pair0: s1, s2 missing: the device sent no value, NaN or more than 1e12; check unit" in outcome.err


@pytest.mark.promise("docs/explanation/readings-to-samples.md", "and 31 equal readings in a row are `stuck`")
@pytest.mark.parametrize("deviation_mm", [0.0, LAST_DIGIT], ids=["constant", "last digit"])
def test_a_frozen_channel_of_fractional_numbers_is_stuck(deviation_mm: FloatArray | float) -> None:
    counts = gaps(WHITE)
    counts[1000:, 2] = gaps(deviation_mm)[1000:, 2]
    pipeline = Pipeline(gauges())
    qualities = [
        taken.sample.quality
        for taken in pipeline.process([Reading(at / RATE_HZ, tuple(row)) for at, row in enumerate(counts.tolist())], 0)
    ]
    stuck = np.array([[quality is Quality.STUCK for quality in row] for row in qualities])
    (longest,) = set(longest_runs(gauges()).tolist())
    assert longest == 31
    assert stuck[:, 2].nonzero()[0][0] == pytest.approx(1000 + longest, abs=25)  # the filter fills with 20 readings
    assert stuck[1060:, 2].all()
    assert not stuck[:, [0, 1, 3]].any()


@pytest.mark.parametrize("deviation_mm", [0.0, LAST_DIGIT], ids=["constant", "last digit"])
@pytest.mark.parametrize("noise_mm", [NOISE_MM, None], ids=["stated", "unknown"])
def test_a_recording_of_a_frozen_channel_is_refused(deviation_mm: FloatArray | float, noise_mm: float | None) -> None:
    counts = gaps(WHITE)
    counts[:, 2] = gaps(deviation_mm)[:, 2]
    with pytest.raises(NotAtRestError, match=r"^s3 stuck: the counts do not change; check the sensor, or state stuck_"):
        select_rest(counts, gauges(noise_mm), {})


@pytest.mark.anyio
async def test_a_tare_of_floats_takes_a_beam_at_rest_and_neither_a_frozen_nor_a_moving_one(tmp_path: Path) -> None:
    chance = Random(3)  # noqa: S311 - noise, not secrets
    taken = 0

    def noisy(mean_mm: float = 2.5) -> float:
        return mean_mm + chance.gauss(0, NOISE_MM)

    def moving() -> tuple[float, float]:
        nonlocal taken
        taken += 1
        return noisy(), noisy(2.5 - 0.001 * taken)

    devices = {
        "rest": lambda: (noisy(), noisy()),
        "frozen": lambda: (noisy(), 2.5),
        "jitter": lambda: (noisy(), 2.5 + chance.choice([0.0, 2.4e-7])),
        "moving": moving,
        "coarse": lambda: (round(noisy(), 2), round(noisy(2.504), 2)),
    }
    said = {}
    for name, values in devices.items():
        async with pymodbus_server([0] * 4, measures(values)) as port:
            for more in ("", NOISE):
                config = configs.write(tmp_path, surface(port, name=name, more=more))
                said[name, bool(more)] = await command("tare", config)
                taken = 0
    for name in ("frozen", "jitter"):
        for is_known in (True, False):
            assert f"{name}: not tared: s2 stuck: the counts do not change; check" in said[name, is_known].err
    for is_known in (True, False):
        assert said["rest", is_known].code == 0, said["rest", is_known].err
        assert "moving: not tared: s2 moved: standard deviation 0.0" in said["moving", is_known].err
    assert said["coarse", False].code == 0, said["coarse", False].err  # it flickers by a step, and nothing moves
    content = json.loads((tmp_path / "rest.tare.json").read_text())["rest_gap_mm"]
    assert content == pytest.approx({"s1": 2.5, "s2": 2.5}, abs=1e-3)


def test_a_step_of_a_quiet_gauge_is_no_motion_but_one_that_a_load_causes_is() -> None:
    between = np.linspace(0.0, 0.4, CHANNELS) + np.linspace(0.2, 0.6, MINUTE)[:, np.newaxis]
    quiet = gaps(0.01 * (between + 0.1 * autoregressive(0.0)), step_mm=0.01)
    loaded = gaps(np.where(np.arange(MINUTE) % 1000 < 940, 0.0, -0.05)[:, np.newaxis], step_mm=0.01)
    for noise_mm in (None, 0.004):
        surface = gauges(noise_mm, smallest_force_mm=0.2, stuck_after_ms=6e4)
        for begin in range(0, MINUTE, TARED):
            assert rest_gaps(quiet[begin : begin + TARED], surface)["s1"] == pytest.approx(2.505, abs=0.006)
        assert len(select_rest(quiet, surface, {})) == MINUTE
        with pytest.raises(NotAtRestError, match=r"s1 moved: standard deviation 0\.02"):
            rest_gaps(loaded[800:1000], surface)
        with pytest.raises(NotAtRestError, match=r"s1 moved by 0\.05 mm"):
            select_rest(loaded, surface, {})


def test_whole_numbers_that_are_shifted_show_the_steps_of_their_adc() -> None:
    """An ADC of 12 bits in the upper bits of 16: a flicker of 16 counts is one step."""
    shifted = 16 * np.rint(1250.4 + 0.3 * autoregressive(0.0))
    surface = surface_of(CHANNELS, filter=mean_of(20), noise_mm=0.0006)
    assert rest_gaps(shifted[:TARED], surface)["s1"] == pytest.approx(2.5, abs=0.003)
    assert {round(one.step_mm, 9) for one in measure_noise(shifted, surface)} == {0.0016}


@pytest.mark.anyio
async def test_a_light_load_on_floats_is_recorded_and_none_is_refused(tmp_path: Path) -> None:
    chance = Random(5)  # noqa: S311 - noise, not secrets
    loads = iter([0.3] * 400 + [0.0] * 1_000_000)

    def values() -> tuple[float, float]:
        return 2.5 + chance.gauss(0, NOISE_MM), 2.5 - next(loads) + chance.gauss(0, NOISE_MM)

    told = await talk(
        tmp_path,
        ["150 10", "250 5", ""],
        "--seconds",
        1,
        action=measures(values),
        surface=lambda port: surface(port, more=NOISE),
    )
    assert "load 1: 10 N at 150 mm, " in told.err
    assert "5 N at 250 mm not recorded: " in told.err
    deflections = [float(row["s2_deflection_mm"]) for row in rows_of(tmp_path / "loads.csv")]
    assert np.mean(deflections) == pytest.approx(0.3, abs=0.001)


def keys_for(counts: FloatArray) -> Keys:
    surface = gauges(None)
    return keys_of(measure_noise(select_rest(counts, surface, {}), surface), surface)


def test_noise_finds_the_steps_that_floats_show_and_none_where_they_show_none() -> None:
    for step_mm in (0.0, 0.001, 0.01):
        assert {round(one.step_mm, 6) for one in measure_noise(gaps(WHITE, step_mm), gauges())} == {step_mm}
    fine, coarse = keys_for(gaps(WHITE)), keys_for(gaps(WHITE / 4 + 0.002, 0.005))
    assert [fine.daemon_noise_mm, fine.scene_noise_mm] == pytest.approx([NOISE_MM] * 2, rel=0.06)
    assert (fine.adc_bits, fine.stuck_after_ms) == (None, {})
    assert [coarse.daemon_noise_mm, coarse.scene_noise_mm] == pytest.approx([0.0025] * 2, rel=0.01)
    assert coarse.adc_bits is None
    assert coarse.zero_drift_mm > 0.005 / math.sqrt(6)  # rounding stays in a mean, and in the tare
    assert sorted(coarse.stuck_after_ms) == ["s1", "s2", "s3", "s4"]  # they may stay at one value for ever


def test_a_beam_at_rest_whose_floats_flicker_by_a_step_is_at_rest_with_the_noise_that_is_stated() -> None:
    counts = gaps(0.01 * (np.array([0.1, 0.3, 0.48, 0.5]) + 0.3 * autoregressive(0.0)), step_mm=0.01)
    keys = keys_for(counts)
    settings = {"kind": "growing-mean", "max_mean_ms": 1000, "window": 4}
    surface = surface_of(CHANNELS, MM, filter=settings, noise_mm=keys.daemon_noise_mm)
    readings = [Reading(at / RATE_HZ, tuple(row)) for at, row in enumerate(counts.tolist())]
    held = [taken.sample.readings or 0 for taken in Pipeline(surface).process(readings, 0)]
    assert np.median(held) == TARED  # a second, the longest mean


@pytest.mark.parametrize(("every", "is_stated"), [(4, False), (40, True)])
def test_a_device_that_is_read_faster_than_it_measures_is_not_stuck_by_what_noise_states(
    every: int, is_stated: bool
) -> None:
    counts = np.repeat(gaps(WHITE)[: MINUTE // every], every, axis=0)
    keys = keys_for(counts)
    recording = Recording(counts, 0, len(counts) / RATE_HZ)
    lines = report([Measurement("bench", gauges(None), recording, measure_noise(counts, gauges(None)), keys)])
    rate = f"so they change {RATE_HZ / every:g} times a second; set rate_hz to that, also in the scene"
    assert f"  s1, s2, s3, s4: values come about {every} times in a row, {rate}" in lines
    assert bool(keys.stuck_after_ms) == is_stated
    surface = gauges(keys.daemon_noise_mm, stuck_after_ms=min(keys.stuck_after_ms.values(), default=None))
    assert longest_runs(surface).min() > 2 * every
    assert len(rest_gaps(counts[:TARED], surface)) == CHANNELS


def test_values_that_come_three_or_four_times_in_a_row_are_told_to_two_digits() -> None:
    counts = np.repeat(gaps(WHITE)[: MINUTE // 4], np.resize([3, 4, 4], MINUTE // 4), axis=0)
    recording = Recording(counts, 0, len(counts) / RATE_HZ)
    found = Measurement("bench", gauges(None), recording, measure_noise(counts, gauges(None)), keys_for(counts))
    assert any("come about 3.7 times in a row, so they change " in line for line in report([found]))


def test_noise_that_floats_do_not_show_is_not_guessed() -> None:
    surface = gauges(0.004, stuck_after_ms=3.6e6)
    with pytest.raises(NotAtRestError, match=r"^s1, s2, s3, s4: neither noise nor steps show, as the counts do not"):
        select_rest(gaps(0.0), surface, {})
