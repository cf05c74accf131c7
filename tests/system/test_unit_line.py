"""The whole line of a structure with strain gauges in uV/V: from measured loads to `GET /contact` and the page."""

from pathlib import Path

import httpx2
import pytest

from beamtouch_models import daemon_config, format_scene, resolve
from line import Surface
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.pages.browser import OpenPage
from support.programs.forked_line import ForkedLine
from support.surfaces.strain_gauges import GAUGES_MM, loads_csv, scene_of

pytestmark = pytest.mark.long

PLACE_MM, FORCE_N, OFF_MM = 50.0, 8.0, 4.0
"""A load on the left overhang, under which all gauges between the supports show less than nothing."""
SCRIPT = f"""
[[step]]
seconds = 1.5
[[step]]
seconds = 600
position_mm = {PLACE_MM}
force_n = {FORCE_N}
"""


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/measured.md", "model, daemon and page show that unit")
def test_a_contact_is_found_and_shown_in_the_unit_of_its_gauges(tmp_path: Path, open_page: OpenPage) -> None:
    scene = scene_of(loads_csv(30))
    model = resolve(scene).place().build("bar", effort=0.05)
    model.save(tmp_path / "bar.onnx")
    for name, text in (
        ("bar.toml", format_scene(scene)),
        ("built.toml", daemon_config(model.metadata)),
        ("script.toml", SCRIPT),
    ):
        (tmp_path / name).write_text(text)
    surface = Surface("bar", "modbus-tcp", tmp_path / "script.toml")
    with ForkedLine(tmp_path, tmp_path / "bar.toml", tmp_path / "bar.onnx", tmp_path / "built.toml", [surface]) as line:
        found, seen = line.wait_for_still_contact(), open_page(line.url)
        seen.wait_for_state("contact")
        seen.wait_for_text("channels", "\u2212")
        rows = [text.split() for text in seen.text("channels").splitlines()]
        heads, caption = seen.page.inner_text("#channels-title + table thead"), seen.text("beam-words")
        summary = httpx2.get(f"{line.url}/surfaces/bar", verify=NO_TLS, timeout=TIMEOUT_S).json()
    assert abs(found["position_mm"] - PLACE_MM) < OFF_MM, found
    assert abs(found["force_n"] - FORCE_N) < 0.1 * FORCE_N, found
    assert summary["unit"] == "uV/V"
    assert "Deflection, uV/V" in heads
    assert "in uV/V, to a scale of their own" in caption
    shown = {row[0]: float(row[2].replace("\u2212", "-")) for row in rows}
    assert set(shown) == set(GAUGES_MM)
    assert shown["g2"] < -10
    assert not seen.complaints
