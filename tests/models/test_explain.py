"""The command `design-sensors explain`."""

import json

import pytest

from example_scenes import SCENES
from in_process import Command

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
    assert shear["cost_us"] == pytest.approx(shear["with_us"] - shear["without_us"])
    assert min(shear["with_us"], shear["without_us"]) > 0
    assert (unstated["price"], unstated["included"], unstated["cost_us"]) == (None, False, None)


def test_a_table_lists_every_effect(design_sensors_here: Command) -> None:
    done = design_sensors_here("explain", SCENES / "wide-contact.toml")
    assert done.returncode == 0
    rows = {line.strip().split("  ")[0]: line for line in done.stdout.splitlines()}
    assert set(NAMES) <= set(rows)
    assert " in " in rows["contact width"]
    assert " out " in rows["foundation"]
    assert "price: in units of a sample's noise, 0.00537 mm" in done.stdout
    # Where the output is no terminal, whole lines and names of keys stay together; how much room there is depends on
    # the times that were measured.
    assert "…" not in done.stdout
    assert "give environment.temperature_range_k and" in rows["sensor drift"]
