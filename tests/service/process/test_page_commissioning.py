"""Commissioning on the page where it cannot go on: what the page says, and what two windows see."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import httpx2

from plain_http import TIMEOUT_S
from service.conftest import batch_of

if TYPE_CHECKING:
    from browser import OpenPage, Watched
    from service.process.conftest import Service, StartService

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


def test_the_page_says_why_nothing_begins_and_what_others_did(start_page: StartService, open_page: OpenPage) -> None:
    service = start_page(read=None)
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
