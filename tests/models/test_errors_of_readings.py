"""The errors of a scene's readings, the filter it gets, and sensors that no model can carry, with their messages."""

from typing import Any

import pytest

from beamtouch_models.design.pricing.noise import ReadingErrors, check_errors, check_scale, choose_filter, step_mm
from beamtouch_models.design.scene import Scene
from beamtouch_models.errors import SceneError
from beamtouch_models.runtime.metadata_parts import FilterChoice
from support.surfaces.example_scenes import paper_scene


def scene_with(parts: dict[str, dict[str, Any]], **sensors: object) -> Scene:
    stated = paper_scene(**sensors).model_dump()
    for name, values in parts.items():
        stated[name] = {**stated[name], **values}
    return Scene.model_validate(stated)


def errors_of(
    largest_mm: float = 2.0, *, of: dict[str, dict[str, Any]] | None = None, **sensors: object
) -> ReadingErrors:
    return ReadingErrors.of(scene_with(of or {}, **sensors), largest_mm)


NOISE: dict[str, Any] = {"noise_percent_of_max": None, "noise_mm": 0.03}


def test_a_noise_in_percent_is_one_of_the_largest_deflection_and_one_in_mm_is_not() -> None:
    assert errors_of(2.0).sensor_mm == errors_of(1.0).sensor_mm * 2 == pytest.approx(0.04)
    assert errors_of(2.0, **NOISE).sensor_mm == 0.03
    assert errors_of(2.0, noise_percent_of_max=0.0).sensor_mm == 0.0
    assert (errors_of().step_mm, errors_of().warmth_mm, errors_of().gain) == (0.0, 0.0, 0.003)
    assert errors_of(gain_error_percent=1.5).gain == pytest.approx(0.015)


def test_the_range_of_a_sensor_takes_four_fifths_of_the_counts() -> None:
    """4 mm of 1.25 times as many over 255 steps."""
    assert step_mm((1.0, 5.0), 8) == pytest.approx(5.0 / 255)
    stepped = errors_of(range_mm=(1.0, 5.0), adc_bits=8, **NOISE)
    assert stepped.step_mm == pytest.approx(5.0 / 255)
    assert stepped.reading_mm == pytest.approx((0.03**2 + (5 / 255) ** 2 / 12) ** 0.5)


def test_zeros_that_no_scene_states_drift_by_a_fifth_of_the_noise_and_of_it_all_in_a_minute() -> None:
    assumed = errors_of(**NOISE)
    assert (assumed.zero_mm, assumed.drift_mm_per_min) == pytest.approx((0.006, 0.03))
    assert errors_of(zero_drift_mm=0.02, **NOISE).zero_mm == 0.02
    stated = errors_of(of={"environment": {"drift_um_per_min": 12.0}}, **NOISE)
    assert stated.drift_mm_per_min == pytest.approx(0.012)


def test_a_hall_moves_even_quiet_zeros_as_far_as_light_contacts_leave_room() -> None:
    """5 um a minute, or a tenth of the largest deflection under the smallest force; unless zeros are stated."""
    quiet: dict[str, Any] = {"noise_percent_of_max": None, "noise_mm": 1e-4}
    assert errors_of(2.0, **quiet).drift_mm_per_min == 0.005
    assert errors_of(0.02, **quiet).drift_mm_per_min == pytest.approx(0.002)
    open_force = {"contact": {"force_n": (2.0, 20.0)}}
    assert errors_of(0.2, of=open_force, **quiet).drift_mm_per_min == pytest.approx(0.002)
    assert errors_of(2.0, zero_drift_mm=0.01, **quiet).drift_mm_per_min == 1e-4


def test_all_errors_but_the_gain_are_those_of_the_unit() -> None:
    whole = ReadingErrors(0.3, 0.04, 0.003, 0.05, 0.12, 0.6)
    assert whole.scaled(2.0) == ReadingErrors(0.6, 0.08, 0.003, 0.1, 0.24, 1.2)
    assert whole.drift_mm == pytest.approx(0.13)
    assert whole.floor_mm == pytest.approx(0.13)  # a step of a seventh of the noise rounds nothing
    noise = whole.behind(FilterChoice(kind="moving-average", window=9))
    assert (noise.reading_mm, noise.sample_mm) == pytest.approx((whole.reading_mm, whole.reading_mm / 3))


def test_rounding_without_noise_stays_twice_and_with_some_its_first_harmonic() -> None:
    """Of q / sqrt(12), and of q / pi exp(-2 (pi s / q)^2) as an amplitude; a tare rounds as well."""
    assert ReadingErrors(0.0, 0.6, 0, 0, 0, 0).rounding_mm == pytest.approx(0.6 / 6**0.5, rel=5e-4)
    assert ReadingErrors(0.3 * 0.6, 0.6, 0, 0, 0, 0).rounding_mm == pytest.approx(0.6 / 3.14159 * 0.16920, rel=1e-3)
    assert ReadingErrors(0.3, 0.0, 0, 0, 0, 0).rounding_mm == 0.0
    assert ReadingErrors(5.0, 0.1, 0, 0, 0, 0).rounding_mm == pytest.approx(0, abs=1e-100)


def filter_of(latency_ms: float, rate_hz: float, reading_mm: float = 0.05, **requirements: object) -> FilterChoice:
    asked = {"latency_ms": latency_ms} | requirements
    return choose_filter(scene_with({"requirements": asked, "sensors": {"rate_hz": rate_hz}}), reading_mm)


def test_a_filter_takes_as_many_readings_as_come_within_the_latency() -> None:
    chosen = filter_of(35.0, 100.0)
    assert (chosen.kind, chosen.window, chosen.settling_ms, chosen.longest) == ("growing-mean", 3, 30.0, 100)
    assert chosen.spike_mm == pytest.approx(0.3)
    assert filter_of(30.0, 100.0).window == 3  # to the last digit
    silent = filter_of(35.0, 100.0, 0.0)
    assert (silent.kind, silent.window, silent.longest, silent.spike_mm) == ("moving-average", 3, None, None)
    assert filter_of(100.0, 100_000.0).window == 10_000


def test_a_latency_of_too_few_or_too_many_readings_is_refused() -> None:
    with pytest.raises(SceneError) as short:
        filter_of(9.5, 100.0)
    assert str(short.value) == (
        "requirements.latency_ms = 9.5 is shorter than one reading (10 ms); raise sensors.rate_hz"
    )
    with pytest.raises(SceneError) as long:
        filter_of(100.1, 100_000.0)
    assert str(long.value) == (
        "requirements.latency_ms = 100.1 holds more than 10000 readings at sensors.rate_hz = 100000; lower one of them"
    )


def refusal(noise_mm: float, largest_mm: float, unit: str = "mm") -> str:
    with pytest.raises(SceneError) as refused:
        check_scale(noise_mm, largest_mm, unit)
    return str(refused.value)


def test_a_scale_that_no_model_carries_is_refused_with_its_numbers() -> None:
    check = (
        "which no sensor measures; check the length and the rigidity of a beam, the table of a measured structure, and "
        "contact.force_n"
    )
    assert refusal(0.0, 9.9e-10) == f"the largest deflection is 9.9e-10 mm, {check}"
    assert refusal(0.0, 1.1e9, "uV/V") == f"the largest deflection is 1.1e+09 uV/V, {check}"
    assert refusal(2001.0, 2.0) == (
        "sensors: a sample's noise of 2000 mm hides the largest deflection, 2 mm; use better sensors or a softer beam"
    )
    assert refusal(2477.0, 1.2345) == (
        "sensors: a sample's noise of 2480 mm hides the largest deflection, 1.23 mm; use better sensors or a softer "
        "beam"
    )
    assert refusal(1.9e-6, 2.0) == (
        "sensors: a sample's noise of 0.0000019 mm is less than 1e-4 % of the largest deflection, 2 mm, too little for "
        "the float32 of a model; state the noise of a real sensor"
    )
    assert refusal(1.2345e-6, 2.3456, "uV/V") == (
        "sensors: a sample's noise of 0.00000123 uV/V is less than 1e-4 % of the largest deflection, 2.35 uV/V, too "
        "little for the float32 of a model; state the noise of a real sensor"
    )
    for noise_mm, largest_mm in ((0.0, 1.0), (1e-9, 1e-9), (1e9, 1e9), (2000.0, 2.0), (2e-6, 2.0)):
        check_scale(noise_mm, largest_mm)


def test_zeros_that_drift_farther_than_any_deflection_are_refused() -> None:
    scene, chosen = (
        scene_with({"sensors": {"drift_um_per_k": 7.5}, "environment": {"temperature_range_k": (-5, 5)}}),
        FilterChoice(),
    )

    def said(zero_mm: float, warmth_mm: float, largest_mm: float = 0.25) -> str:
        with pytest.raises(SceneError) as refused:
            check_errors(scene, ReadingErrors(0.1, 0.0, 0.0, zero_mm, warmth_mm, 0.0), chosen, largest_mm)
        return str(refused.value)

    hides = "hides the largest deflection, 0.25 mm; tare more often, use better sensors or a softer beam"
    assert said(253.74, 3.0) == f"sensors.zero_drift_mm = 254 {hides}"
    assert said(3.0, 251.0) == f"sensors.drift_um_per_k = 7.5 {hides}"
    assert said(300.0, 3.0, 0.25149) == f"sensors.zero_drift_mm = 300 {hides.replace('0.25 mm', '0.251 mm')}"
    check_errors(scene, ReadingErrors(0.1, 0.0, 0.0, 250.0, 250.0, 0.0), chosen, 0.25)
    with pytest.raises(SceneError, match=r"sample's noise of 300 mm"):
        check_errors(
            scene, ReadingErrors(600.0, 0.0, 0.0, 0.0, 0.0, 0.0), FilterChoice(kind="moving-average", window=4), 0.25
        )
