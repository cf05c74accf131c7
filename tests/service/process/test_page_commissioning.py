"""Commissioning on the page in a real browser: faults of sensors and cables, and where it cannot go on."""

import json
import signal
from pathlib import Path

import httpx2
import pytest
from playwright.sync_api import ViewportSize

from service.bench import TOKEN, Row, batch_of
from service.process.beam_page import Bench, StartBench
from service.process.conftest import Service, StartService
from support.network.plain_http import TIMEOUT_S
from support.pages.browser import OpenPage, Watched

PHONE: ViewportSize = {"width": 390, "height": 844}
FORCE_N = 10
HELD = 5
"""Batches of a quarter of a second: a press must be held for a second."""


def send_through_the_cables(bench: Bench, *loads: tuple[float, float]) -> None:
    """Send what arrives under loads if s1 and s4 are swapped, s2 is inverted, and s3 is dead."""
    first, second, _, fourth = bench.deflection_mm(*loads)
    row: Row = [fourth, -second, None, first]
    for _ in range(HELD):
        bench.send(list(row))


def press(seen: Watched, bench: Bench, prompt: str, at_mm: float) -> None:
    """Press once the page asks for it, until it says that it has seen that; then lift."""
    seen.wait_for_text("commissioning-prompt", prompt)
    send_through_the_cables(bench, (at_mm, FORCE_N))
    seen.wait_for_text("commissioning-prompt", "Lift")
    send_through_the_cables(bench)


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "its channel shows the sensor s4: swap the cables of the two",
)
def test_the_page_finds_swapped_cables_an_inverted_sensor_and_a_dead_one(
    start_bench: StartBench, open_page: OpenPage
) -> None:
    bench = start_bench()
    send_through_the_cables(bench)
    seen = open_page(bench.service.url, size=(1280, 900))
    seen.wait_for_state("clear")
    seen.page.click("#commissioning-open")
    seen.wait_for_text("commissioning-prompt", "No commissioning is under way")
    seen.page.fill("#commissioning-token", TOKEN)
    seen.page.keyboard.press("Enter")
    seen.wait_for_text("commissioning-prompt", "Take everything off")
    send_through_the_cables(bench)
    for channel in bench.model.metadata.layout:
        press(seen, bench, f"Press above {channel.name}", channel.position_mm)
    seen.wait_for_text("commissioning-prompt", "Press at the mark")
    seen.page.wait_for_selector("#beam .target", state="attached")
    seen.picture("commissioning-desk")
    assert seen.unreadable() == []
    seen.page.set_viewport_size(PHONE)
    assert seen.overflow() <= 0
    seen.page.evaluate("document.getElementById('commissioning').scrollIntoView()")
    seen.picture("commissioning-phone")
    for _ in range(3):
        at_mm = bench.service.get("/surfaces/press-7/commissioning").json()["run"]["at_mm"]["position"]
        press(seen, bench, f"Press at the mark, {at_mm:.0f} mm", at_mm)
    seen.wait_for_text("commissioning-prompt", "Every step is done")
    verdict = seen.text("commissioning-verdict")
    for said in ("The cables of s1 and s4 are swapped", "s2 moves the wrong way", "s3 does not move"):
        assert said in verdict
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
    assert [sentence in text for sentence in verdict.splitlines()] == [True] * len(result["verdict"])
    assert (result["by"], result["passed"], result["surface"]) == ("Ann", False, "press-7")
    findings = [sensor["finding"] for sensor in result["sensors"]]
    assert findings == ["swapped", "inverted", "dead", "swapped"]
    assert seen.complaints == []


PATH = "/surfaces/press-7/commissioning"


def begin(seen: Watched, token: str) -> None:
    """Type a token, and begin."""
    seen.page.fill("#commissioning-token", token)
    seen.page.keyboard.press("Enter")


def refusal(service: Service, token: str) -> dict[str, str]:
    """Return the problem with which the service answers to the same."""
    headers = {"Authorization": f"Bearer {token}"}
    answer = httpx2.post(service.url + PATH, headers=headers, trust_env=False, timeout=TIMEOUT_S)
    assert not answer.is_success
    body: dict[str, str] = answer.json()
    return body


@pytest.mark.soak
def test_the_page_says_why_nothing_begins_and_what_others_did(start_press: StartService, open_page: OpenPage) -> None:
    service = start_press()
    seen = open_page(service.url)
    seen.wait_for_state("problem")
    seen.page.click("#commissioning-open")
    seen.wait_for_text("commissioning-prompt", "No commissioning is under way.")
    begin(seen, "")
    assert seen.text("commissioning-error") == "Type the write token of the service."
    wrong = "not-the-token-of-this-service"
    begin(seen, wrong)
    seen.wait_for_text("commissioning-error", refusal(service, wrong)["detail"])
    begin(seen, service.token)
    reason = refusal(service, service.token)
    seen.wait_for_text("commissioning-error", f"{reason['title']}. {reason['detail']}")

    service.post(batch_of([0.0, 0.0, 0.0]))
    seen.page.click("#commissioning-start")
    asked = "Take everything off the beam, and wait until it lies still."
    seen.wait_for_text("commissioning-prompt", asked)
    assert seen.text("commissioning-error") == ""
    other = seen.beside()
    other.page.click("#commissioning-open")
    other.wait_for_text("commissioning-prompt", asked)
    other.page.fill("#commissioning-token", service.token)
    other.page.click("#commissioning-abandon")
    for one in (seen, other):
        one.wait_for_text("commissioning-prompt", "It was abandoned.")
    service.stop(signal.SIGKILL)
    seen.wait_for_text("commissioning-prompt", "The service does not answer. Trying again.")
