"""What `design-sensors explain --zones` says of zones."""

import json
from pathlib import Path

import numpy as np
import pytest

from beamtouch_common.outline import BEAM_AXIS, Outline, Span
from beamtouch_common.zones import BEGIN, Zone, ZoneState
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.posterior import posterior_quantiles
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.zone_bands import band_at
from beamtouch_models.places import Extent, on_axis
from beamtouch_models.runtime.error_model import Errors
from support.programs.in_process import Command, Refusal
from support.surfaces.example_scenes import SCENES


def _scales(place_mm: Floats) -> Floats:
    """A rigid bar on two springs of 1 N/mm at its ends: each carries the load by its lever."""
    share = place_mm / 100
    return np.concatenate([1 - share, share], axis=-1)


@pytest.mark.parametrize(("noise_mm", "width_mm"), [(0.05, 2.3284), (0.01, 0.46568)])
def test_the_band_of_a_bar_on_two_scales(noise_mm: float, width_mm: float) -> None:
    # Under F = 10 N, the position is l/2 (1 + (d2 - d1)/F), of deviation l s / (F sqrt(2)).
    # The band is 2 * 1.68 * 1.96 of it.
    prior = Prior(Extent.of_beam((0.0, 100.0)), 100.0, (10.0, 10.0), Errors(noise_mm), 2, _scales)
    band = band_at(prior, 40.0, 1)
    assert band.width_mm == pytest.approx(width_mm, rel=0.04)
    assert band.wrong <= 0.005


@pytest.mark.parametrize("edge_mm", [1.0, 5.0, 40.0])
def test_the_band_ends_with_the_contacts(edge_mm: float) -> None:
    # The integral itself: contacts all over the bar, of which the share that is unsure.
    prior = Prior(Extent.of_beam((0.0, 100.0)), 100.0, (10.0, 10.0), Errors(0.5), 2, _scales)
    random = np.random.default_rng(2)
    position_mm = random.uniform(0, 100, 4000)
    clean, deviation = prior.sampled(on_axis(position_mm), np.full(4000, 10.0))
    samples = clean + random.normal(size=clean.shape) * deviation
    spans = posterior_quantiles(prior, samples, np.tile((0.5, 0.025, 0.975), (4000, 1)))[0]
    zone = Zone(from_mm=edge_mm, to_mm=100.0)
    outline = Outline.of_beam(100.0)
    lies = [zone.lies({BEAM_AXIS: Span(*span)}, None, outline, BEGIN) for span in spans.tolist()]
    unsure = np.array([one is ZoneState.UNSURE for one in lies])
    assert band_at(prior, edge_mm, 1).width_mm == pytest.approx(
        100 * unsure.mean(), abs=3 * 100 * unsure.std() / 4000**0.5
    )


def test_where_there_are_no_contacts_there_is_no_band() -> None:
    prior = Prior(Extent.of_beam((40.0, 60.0)), 100.0, (10.0, 10.0), Errors(0.01), 2, _scales)
    assert band_at(prior, 3.0, 1)[1:] == (0.0, 0.0)


@pytest.mark.soak
@pytest.mark.promise(
    "docs/how-to/zones.md",
    "it prints a line for each edge within the beam",
    "`explain --zones` forecasts the zones of beams only.",
)
def test_explain_forecasts_each_edge_within_the_beam(
    design_sensors_roughly: Command, refused: Refusal, tmp_path: Path
) -> None:
    path = tmp_path / "zones.toml"
    path.write_text("[zones.left]\nfrom_mm = 0\nto_mm = 120\n[zones.gate]\nfrom_mm = 120\nto_mm = 380\n")
    scene = SCENES / "bench.toml"
    edges = json.loads(design_sensors_roughly("explain", scene, "--zones", path, "--json").stdout)["zones"]
    assert [(edge["zone"], edge["edge_mm"]) for edge in edges] == [("left", 120), ("gate", 120), ("gate", 380)]
    # Next to a support the beam says little of the place.
    assert edges[0]["unsure_mm"] == edges[1]["unsure_mm"] < edges[2]["unsure_mm"] / 2

    path.write_text(path.read_text() + "least_force_n = 18\n")
    forced = json.loads(design_sensors_roughly("explain", scene, "--zones", path, "--json").stdout)["zones"]
    assert forced[0] == edges[0]
    assert forced[1]["unsure_mm"] < edges[1]["unsure_mm"]
    path.write_text("[zones.gate]\nfrom_mm = 120\nto_mm = 380\nleast_force_n = 21\n")
    said = "zones.gate: no contact of the scene has such a force; its forces are 2 to 20 N"
    assert said in refused("explain", scene, "--zones", path)

    path.write_text("[zones.gate]\nfrom_mm = 120\nto_mm = 500\n")
    words = f"design-sensors: {path}: zones.gate: to_mm = 500 is beyond the end of the beam, which is 400 mm long\n"
    assert refused("explain", scene, "--zones", path) == words
    words = "design-sensors: --zones: forecasts zones of beams only; leave it out for a structure of two axes\n"
    assert refused("explain", SCENES / "plate-on-springs.toml", "--zones", path) == words
