"""What `design-sensors explain` says of effects and of zones whose bands are known."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from beamtouch_models.design import layout
from beamtouch_models.design.accuracy import zone_bands
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.zone_bands import Band
from beamtouch_models.design.layout import Layout, keep_sensors
from beamtouch_models.design.surface import Surface
from support.programs.in_process import Command, Outcome, Refusal
from support.surfaces.example_scenes import SCENES

BENCH = SCENES / "bench.toml"
"""400 mm long, under 2 to 20 N, with four readings in a sample."""


def tables_of(done: Outcome) -> list[list[str]]:
    """Return the words of each printed line."""
    return [line.split() for line in done.stdout.splitlines()]


def test_a_price_is_the_size_in_um_over_the_noise_of_a_sample_to_two_digits(
    design_sensors_here: Command,
) -> None:
    found = json.loads(design_sensors_here("explain", BENCH, "--json").stdout)
    assert found["noise_mm"] == pytest.approx(found["reading_noise_mm"] / 2)
    assert found["max_deflection_mm"] == pytest.approx(20 * 400**3 / (48 * 210e3 * 25 * 3**3 / 12), rel=1e-3)
    assert found["reading_noise_mm"] == pytest.approx(0.002 * found["max_deflection_mm"], rel=0.05)
    assert found["negligible"] == 0.1
    said = tables_of(design_sensors_here("explain", BENCH))
    priced = [one for one in found["effects"] if one["price"] is not None]
    assert len(priced) > 3
    for effect in priced:
        (row,) = (line for line in said if line[: len(effect["name"].split())] == effect["name"].split())
        um, price = row[len(effect["name"].split()) :][:2]
        assert float(price) == float(f"{effect['price']:.2g}")
        assert float(um) == float(f"{1e3 * found['noise_mm'] * effect['price']:.2g}")
        assert (effect["verdict"] == "in") is effect["included"]
    assert {one["verdict"] for one in found["effects"]} > {"floor", "not stated"}


def test_a_tolerance_of_the_force_that_is_assumed_is_told_with_the_range_that_it_gives(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(BENCH.read_text().replace("force_n = [2.0, 20.0]", "force_n = 10.0"))
    lines = design_sensors_here("explain", scene).stdout.splitlines()
    (line,) = (line for line in lines if line.startswith("force: "))
    assert line.startswith("force: 9.9 to 10.1 N, as contact.force_tolerance_percent is not stated and 1 then")
    assert "force: " not in design_sensors_here("explain", BENCH).stdout


Forecast = Callable[[str], Outcome]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What was asked of the bands: each is a hundredth of its place wide, and wrong for a share of it."""
    asked = list[dict[str, Any]]()

    def band(prior: Prior, edge_mm: float, _seed: int, range_n: tuple[float, float]) -> Band:
        asked.append({"edge_mm": edge_mm, "range_n": range_n, "noise_mm": prior.errors.noise_mm})
        return Band(edge_mm, edge_mm / 80, edge_mm / 123456)

    def place(surface: Surface, **_: object) -> Layout:
        return keep_sensors(surface, (60.0, 150.0, 250.0, 340.0))

    monkeypatch.setattr(zone_bands, "band_at", band)
    monkeypatch.setattr(layout, "place_sensors", place)
    return asked


@pytest.fixture
def forecast(design_sensors_here: Command, tmp_path: Path) -> Forecast:
    def run(zones: str, *options: object) -> Outcome:
        path = tmp_path / "zones.toml"
        path.write_text(zones)
        done = design_sensors_here("explain", BENCH, "--zones", path, *options)
        assert done.returncode == 0, done.stderr
        return done

    return run


def zone(name: str, from_mm: float, to_mm: float, **forces_n: float) -> str:
    forces = "".join(f"{key} = {force_n}\n" for key, force_n in forces_n.items())
    return f"[zones.{name}]\nfrom_mm = {from_mm}\nto_mm = {to_mm}\n{forces}"


def test_each_edge_within_the_beam_has_the_width_of_its_band_and_the_percent_that_is_wrong(
    forecast: Callable[..., Outcome], asked: list[dict[str, Any]]
) -> None:
    text = zone("west", 0, 100) + zone("gate", 123, 320) + zone("east", 333, 400)
    found = json.loads(forecast(text, "--json").stdout)["zones"]
    assert [(one["zone"], one["edge_mm"]) for one in found] == [
        ("west", 100), ("gate", 123), ("gate", 320), ("east", 333),
    ]  # fmt: skip
    assert [one["unsure_mm"] for one in found] == [1.25, 1.5375, 4.0, 4.1625]
    assert [one["wrong_percent"] for one in found] == pytest.approx(
        [100 / 1234.56, 123 / 1234.56, 320 / 1234.56, 333 / 1234.56]
    )
    said = tables_of(forecast(text))
    rows = [line for line in said if line and line[0] in {"west", "gate", "east"}]
    assert rows == [
        ["west", "100", "1.25", "0.08"], ["gate", "123", "1.54", "0.10"],
        ["gate", "320", "4", "0.26"], ["east", "333", "4.16", "0.27"],
    ]  # fmt: skip
    # Of a load at rest, whose mean has grown: less than that of a sample.
    assert {one["noise_mm"] for one in asked} == {asked[0]["noise_mm"]}
    assert asked[0]["noise_mm"] < json.loads(forecast(text, "--json").stdout)["noise_mm"]


@pytest.mark.parametrize(
    ("bounds", "range_n"),
    [
        ({}, (2, 20)),
        ({"least_force_n": 5.0}, (5, 20)),
        ({"largest_force_n": 6.0}, (2, 6)),
        ({"least_force_n": 1.0, "largest_force_n": 30.0}, (2, 20)),
        ({"least_force_n": 3.0, "largest_force_n": 4.0}, (3, 4)),
        ({"least_force_n": 20.0}, (20, 20)),
        ({"largest_force_n": 2.0}, (2, 2)),
    ],
)
def test_a_band_is_that_of_the_forces_of_the_scene_that_the_zone_takes(
    forecast: Forecast, asked: list[dict[str, Any]], bounds: dict[str, float], range_n: tuple[float, float]
) -> None:
    forecast(zone("gate", 0, 320, **bounds))
    assert [(one["edge_mm"], one["range_n"]) for one in asked] == [(320, range_n)]


@pytest.mark.parametrize("bounds", [{"least_force_n": 20.1}, {"largest_force_n": 1.9}])
def test_a_zone_of_forces_that_no_contact_has_is_refused(
    refused: Refusal, tmp_path: Path, bounds: dict[str, float]
) -> None:
    path = tmp_path / "zones.toml"
    path.write_text(zone("gate", 0, 320, **bounds))
    said = f"{path}: zones.gate: no contact of the scene has such a force; its forces are 2 to 20 N\n"
    assert refused("explain", BENCH, "--zones", path).endswith(said)


def test_zones_that_end_with_the_beam_have_no_edge_and_no_table(
    forecast: Callable[..., Outcome], asked: list[dict[str, Any]]
) -> None:
    done = forecast(zone("all", 0, 400))
    assert (asked, "unsure mm" in done.stdout) == ([], False)
    assert json.loads(forecast(zone("all", 0, 400), "--json").stdout)["zones"] == []
