"""The scene of recorded loads: contacts, forces, rate, range and noise as recorded, and what is said of them."""

from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.building.recorded_noise import independent_variance
from beamtouch_models.design.building.scene_of_loads import assumed_of, scene_of_loads
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.design.scene import Scene

PLACES = (20, 90, 170, 230, 290, 360)


def recorded(
    path: Path,
    forces_n: tuple[float, ...] = (6.0,) * 6,
    *,
    most: float = 0.6,
    unit: str = "mm",
    samples: int = 6,
    step_s: float | None = None,
    spread: float = 0.004,
    quality: str = "",
) -> Path:
    """Loads of two sensors that show up to `most`, with samples that differ by `spread`."""
    stamp, flaw = ("unix_time_s,", ",a_quality") if step_s else ("", ",a_quality" if quality else "")
    head = f"{stamp}load,position_mm,force_n,a_deflection_{unit},b_deflection_{unit}{flaw}"
    rows, number = [head], 0
    for load, (place, force) in enumerate(zip(PLACES, forces_n, strict=True), start=1):
        shown = most * place / 360
        for sample in range(samples):
            time = f"{1e9 + number * (step_s or 0.0):.4f}," if step_s else ""
            off = spread * (-1) ** sample
            good = f",{quality or 'good'}" if flaw else ""
            rows.append(f"{time}{load},{place},{force},{shown + off:.6f},{-0.3 * shown + off:.6f}{good}")
            number += 1
    path.write_text("\n".join(rows) + "\n")
    return path


def scene(tmp_path: Path, *args: tuple[float, ...], **options: object) -> Scene:
    return scene_of_loads(recorded(tmp_path / "loads.csv", *args, **options))  # type: ignore[arg-type]


def test_contacts_are_where_loads_lay_and_forces_those_recorded_or_from_a_fifth_of_the_largest(tmp_path: Path) -> None:
    alike = scene(tmp_path)
    assert alike.contact.position_mm == (20, 360)
    assert alike.contact.force_range_n == pytest.approx((1.2, 6))
    assert scene(tmp_path, (5.0, 6.0, 7.0, 8.0, 9.0, 10.0)).contact.force_range_n == pytest.approx((2, 10))
    assert scene(tmp_path, (1.5, 6.0, 7.0, 8.0, 9.0, 10.0)).contact.force_range_n == pytest.approx((1.5, 10))
    assert alike.requirements.descriptors == ("position", "force")


@pytest.mark.parametrize(
    ("most", "unit", "range_of"),
    [
        (0.6, "mm", (1, 4)),
        (4.0, "mm", (1, 1 + 1.25 * 5.2)),  # up to 4 and down to -1.2
        (4.0, "uV/V", (-6.5, 6.5)),
        (4.321, "uV/V", (-7.02, 7.02)),  # 1.25 times 5.6173 to three digits
    ],
)
def test_sensors_have_room_for_a_quarter_more_than_they_showed(
    tmp_path: Path, most: float, unit: str, range_of: tuple[float, float]
) -> None:
    found = scene(tmp_path, most=most, unit=unit, spread=1e-5)
    assert found.sensors.range_mm == pytest.approx(range_of, rel=2e-4)


@pytest.mark.parametrize(
    ("step_s", "rate_hz", "latency_ms"),
    [
        (None, 100.0, 50.0),
        (0.01, 100.0, 50.0),
        (0.0991, 10.0, 100.0),  # 10.09 a second is 10 to a hundredth
        (0.0984, 10.2, 1e3 / 10.2),
        (0.4264, 2.35, 1e3 / 2.35),
    ],
)
def test_the_rate_is_that_of_the_stamps_a_whole_number_if_it_is_almost_one(
    tmp_path: Path, step_s: float | None, rate_hz: float, latency_ms: float
) -> None:
    found = scene(tmp_path, step_s=step_s)
    assert found.sensors.rate_hz == pytest.approx(rate_hz)
    assert found.requirements.latency_ms == pytest.approx(latency_ms)


def test_noise_is_that_of_samples_under_one_load(tmp_path: Path) -> None:
    """Six samples at +-4 um: over five degrees of freedom."""
    found = scene(tmp_path)
    assert found.sensors.noise_mm == pytest.approx(0.004 * (6 / 5) ** 0.5, rel=1e-3)
    said = assumed_of(found)
    assert said.startswith("taken from the loads: contacts at 20 to 360 mm with 1.2 to 6 N, ")
    assert f"{1e3 * (found.sensors.noise_mm or 0):.3g} um of noise in each of 100 samples a second; " in said


def test_loads_of_too_few_samples_or_samples_that_do_not_differ_tell_no_noise(tmp_path: Path) -> None:
    told = r"loads\.csv: no load has 5 samples that differ, which tell the noise; record loads with beamtouch-daemon"
    for options in ({"samples": 4}, {"spread": 0.0}):
        with pytest.raises(RecordingError, match=told):
            scene(tmp_path, **options)
    assert scene(tmp_path, samples=5).sensors.noise_mm is not None
    influence = tmp_path / "influence.csv"
    influence.write_text("position_mm,a_mm_per_n\n10,0.1\n60,0.2\n200,0.4\n240,0.3\n")
    with pytest.raises(RecordingError, match="it has influence, not loads; name it in a scene: "):
        scene_of_loads(influence)


def test_a_variance_is_over_the_degrees_of_freedom_of_each_load() -> None:
    rng = np.random.default_rng(8)
    series = [rng.normal(size=count) + 10 * count for count in (3, 5, 9)]
    pooled = sum(((one - one.mean()) ** 2).sum() for one in series) / (2 + 4 + 8)
    assert independent_variance(series) == pytest.approx((pooled, pooled))


def test_samples_that_repeat_are_worth_as_many_as_differ() -> None:
    """Each twice: means of two are independent again, and vary by half of a reading's variance each."""
    rng = np.random.default_rng(9)
    readings = rng.normal(size=400)
    _, twice = independent_variance([np.repeat(readings, 2)])
    means = {
        count: count / 2 * (np.diff(np.repeat(readings, 2).reshape(-1, count).mean(axis=1)) ** 2).mean()
        for count in (2, 4, 8, 16, 32)
    }
    assert twice == pytest.approx(max(means.values()))
