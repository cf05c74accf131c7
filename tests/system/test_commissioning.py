"""Commissioning in a browser, with a rig whose cables are swapped and whose sensors are inverted and dead."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from playwright.sync_api import ViewportSize

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_service.commissioning.course import marks
from example_scenes import SCENES
from forked_line import ForkedLine, put_on
from line import Surface

if TYPE_CHECKING:
    from browser import OpenPage, Watched

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

PHONE: ViewportSize = {"width": 390, "height": 844}
FORCE_N = 10


class LineByHand(ForkedLine):
    """A line with one surface, on which the test presses."""

    def hand(self, load: str) -> None:
        """Put a load on in place of the last one, or nothing; it is so when this returns."""
        put_on(self._processes["rig-bench"], load)

    def end(self, name: str) -> int:
        """End one process; the hand of the rig is withdrawn first."""
        stdin = self._processes[name].stdin
        if stdin is not None:
            stdin.close()
        return super().end(name)

    def _start_rig(self, surface: Surface) -> dict[str, Any]:
        return super()._start_rig(surface) | {"timeout_ms": 5000.0}


def press(seen: Watched, line: LineByHand, prompt: str, at_mm: float) -> None:
    """Press once the page asks for it, until it says that it has seen that; then lift."""
    seen.wait_for_text("commissioning-prompt", prompt)
    line.hand(f"{at_mm} {FORCE_N}")
    seen.wait_for_text("commissioning-prompt", "Lift")
    line.hand("")


def test_the_page_finds_swapped_cables_an_inverted_sensor_and_a_dead_one(
    bench_model: Path, tmp_path: Path, open_page: OpenPage
) -> None:
    metadata = modelfile.load(bench_model).metadata
    config = tmp_path / "generated.toml"
    config.write_text(daemon_config(metadata).replace("rate_hz = 200", "rate_hz = 50"))
    faults = ("--fault", "swapped:s1,s4", "--fault", "inverted:s2", "--fault", "unplugged:s3")
    surface = Surface("bench", "modbus-tcp", rig_options=("--by-hand", *faults))
    sections = {"surfaces": {"bench": {"model": str(bench_model), "stale_ms": 5000}}}
    with LineByHand(tmp_path, SCENES / "bench.toml", bench_model, config, [surface], sections) as line:
        seen = open_page(line.url, size=(1280, 900))
        seen.wait_for_state("unexplained")
        seen.page.click("#commissioning-open")
        seen.wait_for_text("commissioning-prompt", "No commissioning is under way")
        seen.page.fill("#commissioning-token", (tmp_path / "token").read_text())
        seen.page.keyboard.press("Enter")
        for channel in metadata.layout:
            press(seen, line, f"Press above {channel.name}", channel.position_mm)
        seen.wait_for_text("commissioning-prompt", "Press at the mark")
        seen.page.wait_for_selector("#beam .target", state="attached")
        seen.picture("commissioning-desk")
        assert min(contrast for _, contrast in seen.contrasts()) >= 4.5
        seen.page.set_viewport_size(PHONE)
        assert seen.overflow() <= 0
        seen.page.evaluate("document.getElementById('commissioning').scrollIntoView()")
        seen.picture("commissioning-phone")
        for at_mm in marks(metadata):
            press(seen, line, f"Press at the mark, {at_mm:.0f} mm", at_mm)
        seen.wait_for_text("commissioning-prompt", "Every step is done")
        verdict = seen.text("commissioning-verdict")
        seen.page.click("#commissioning-confirm button")
        seen.wait_for_text("commissioning-error", "Type your name.")
        seen.page.fill("#commissioning-by", "Ann")
        seen.page.keyboard.press("Enter")
        seen.wait_for_text("commissioning-newest-words", "not passed")
        with seen.page.expect_download() as download:
            seen.page.click("#commissioning-json")
        result = json.loads(Path(download.value.path()).read_text())
        with seen.page.expect_download() as download:
            seen.page.click("#commissioning-text")
        text = Path(download.value.path()).read_text()
        seen.picture("commissioning-done")
        assert seen.complaints == []
    assert [sentence in text for sentence in verdict.splitlines()] == [True] * len(result["verdict"])
    assert "The cables of s1 and s4 are swapped" in verdict
    assert "s2 moves the wrong way" in verdict
    assert "s3 does not move" in verdict
    assert (result["by"], result["passed"], result["surface"]) == ("Ann", False, "bench")
    findings = [sensor["finding"] for sensor in result["sensors"]]
    assert findings == ["swapped", "inverted", "dead", "swapped"]
