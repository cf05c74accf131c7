"""The command `design-sensors explain`."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from support.programs.in_process import Command
from support.surfaces.example_scenes import SCENES

NAMES = [
    "shear",
    "contact width",
    "self-weight",
    "overhang",
    "steps",
    "foundation",
    "dynamics",
    "sensor curve",
    "ADC steps",
    "gain error",
    "zero drift",
    "drift in a minute",
    "mounting tolerance",
    "expansion",
    "sensor drift",
]


def test_one_json_object_holds_every_effect(design_sensors_here: Command) -> None:
    done = design_sensors_here("explain", SCENES / "short-deep.toml", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    explained = json.loads(done.stdout)
    effects = {effect["name"]: effect for effect in explained["effects"]}
    assert list(effects) == NAMES
    assert explained["noise_mm"] == pytest.approx(0.001 / 10**0.5)
    shear, unstated = effects["shear"], effects["sensor curve"]
    assert (shear["included"], shear["verdict"]) == (True, "in")
    # In the middle, under the largest force: F L / (4 k G A), in units of a sample's noise.
    assert shear["price"] == pytest.approx(150 * 100 / (4 * 5 / 6 * 900 * 15 * 20) / explained["noise_mm"], rel=1e-3)
    assert (unstated["price"], unstated["included"]) == (None, False)


def test_a_table_lists_every_effect(design_sensors_here: Command) -> None:
    done = design_sensors_here("explain", SCENES / "wide-contact.toml")
    assert done.returncode == 0
    rows = {line.strip().split("  ")[0]: line for line in done.stdout.splitlines()}
    assert set(NAMES) <= set(rows)
    um, price, verdict, *remark = rows["contact width"].split()[2:]
    assert float(um) == pytest.approx(5.37 * float(price), rel=0.02)
    assert (verdict, remark) == ("included", ["60", "mm"])
    assert " left out " in rows["foundation"]
    assert "over a sample's noise, 5.37 um" in done.stdout
    # Names of keys stay whole.
    assert "…" not in done.stdout
    assert "state environment.temperature_range_k and" in rows["sensor drift"]


@pytest.mark.parametrize("scene", sorted(path.stem for path in SCENES.glob("*.toml")))
def test_no_line_is_longer_than_a_page_is_wide(design_sensors_here: Command, scene: str) -> None:
    printed = design_sensors_here("explain", SCENES / f"{scene}.toml").stdout.splitlines()
    assert max(map(len, printed)) <= 100


@pytest.mark.promise(
    "docs/how-to/design.md",
    "Without the key, it is 5, as in a hall that warms in the morning,",
    "or the noise of a reading in um where that is larger.",
    "A scene that states `zero_drift_mm` is taken at its word: then it is the noise of a reading.",
)
@pytest.mark.parametrize(
    ("sensors", "environment", "um"),
    [("", "", 5.0), ("zero_drift_mm = 0.0004", "", 2.0), ("", "[environment]\ndrift_um_per_min = 3\n", 3.0)],
    ids=["nothing", "zero drift", "drift"],
)
def test_a_drift_is_priced_by_what_each_zero_may_be_off_after_a_contact_of_a_minute(
    sensors: str, environment: str, um: float, design_sensors_here: Command, tmp_path: Path
) -> None:
    scene, text = tmp_path / "scene.toml", (SCENES / "two-spans.toml").read_text()
    scene.write_text(re.sub(r"(?m)^zero_drift_mm = .*$", sensors, text) + f"\n{environment}")
    done = design_sensors_here("explain", scene, "--json")
    printed = json.loads(done.stdout)
    (drift,) = [one for one in printed["effects"] if one["name"] == "drift in a minute"]
    assert drift["price"] == pytest.approx(0.5e-3 * um / (0.002 / 5**0.5))
    assert f"zeros drift by {um:g} um a minute together" in drift["reason"]
    assert ("(assumed)" in drift["reason"]) == (not environment)


@pytest.mark.promise("docs/how-to/design.md", "but no more than a tenth of what the smallest force moves the beam")
def test_a_drift_that_nobody_states_is_small_beside_what_the_smallest_force_does(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    # Twice the length bends eight times as far.
    said = []
    for length_mm in (200, 400):
        (tmp_path / "scene.toml").write_text(
            f"[beam]\nlength_mm = {length_mm}\nyoungs_modulus_gpa = 210\nwidth_mm = 25\nthickness_mm = 10\n"
            f"[contact]\nforce_n = [2, 20]\nposition_mm = [1, {length_mm - 1}]\n"
            "[sensors]\ncount = 4\nnoise_mm = 1e-5\nrate_hz = 100\n"
        )
        printed = json.loads(design_sensors_here("explain", tmp_path / "scene.toml", "--json").stdout)
        (drift,) = [one for one in printed["effects"] if one["name"] == "drift in a minute"]
        said.append(float(drift["reason"].split()[3]))
    # F L^3 / (48 E I) under 2 N in the middle, in um; a tenth of it.
    inertia_mm4 = 25 * 10**3 / 12
    least_um = 1e3 * 2 * 200**3 / (48 * 210e3 * inertia_mm4)
    assert said == pytest.approx([0.1 * least_um, 0.8 * least_um], rel=0.01)


@pytest.mark.promise("docs/how-to/design.md", "says that readings at `rate_hz` do not show the swings of a mode")
def test_modes_that_seem_to_stand_still_are_named_with_a_better_rate(design_sensors_here: Command) -> None:
    done = design_sensors_here("explain", SCENES / "conveyor.toml", "--json")
    ringing = json.loads(done.stdout)["ringing"]
    (still,) = ringing["aliased"]
    assert still["mode"] == 2
    assert still["seen_hz"] == pytest.approx(abs(still["frequency_hz"] - 100), rel=1e-6)
    assert still["share"] == pytest.approx(1 / 16, rel=0.1)  # of the first one: 1/k^4
    better = ringing["better_rate_hz"]
    assert abs(still["frequency_hz"] - round(still["frequency_hz"] / better) * better) > 10
    text = " ".join(design_sensors_here("explain", SCENES / "conveyor.toml").stdout.split())
    assert "mode 2, of 96.1 Hz, looks like 3.9 Hz to the readings" in text
    # A hundredth, and half of what the aliased mode swings.
    assert ringing["unseen_swing"] == pytest.approx(0.01 + still["share"] / 2)
    assert f"intervals therefore allow for {100 * ringing['unseen_swing']:.1f} % of its swing" in text
    assert f"at {better:g} readings a second, less seems to stand still: 1 % of the swing" in text
    assert "to the readings" not in design_sensors_here("explain", SCENES / "bench.toml").stdout


def test_of_rates_that_show_the_modes_as_well_the_nearest_is_named(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    def explained(rate_hz: float) -> dict[str, Any]:
        scene = tmp_path / "scene.toml"
        scene.write_text((SCENES / "conveyor.toml").read_text().replace("rate_hz = 100", f"rate_hz = {rate_hz:g}"))
        ringing: dict[str, Any] = json.loads(design_sensors_here("explain", scene, "--json").stdout)["ringing"]
        return ringing

    found = explained(210)
    assert [one["mode"] for one in found["aliased"]] == [3]  # of 216 Hz
    # Rates from 241 a second on show all modes as well, but are further off.
    assert found["better_rate_hz"] == pytest.approx(180, abs=1)
    for rate_hz in (180, 250):
        other = explained(rate_hz)
        assert (other["aliased"], other["unseen_swing"]) == ([], 0.01)
