"""The page of a service with a token for reading, in a real browser: what it shows to whom, and where the token is."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

from browser import NO_FIGURE
from service.conftest import READ_TOKEN, batch_of
from service.process.token_page import FORM, KEPT, WRONG, again, assert_locked, assert_only_refusals, assert_open, enter

if TYPE_CHECKING:
    from browser import OpenPage
    from service.process.conftest import StartService

OTHER = "another-token-since-the-restart"


def test_from_the_form_to_the_figures_and_back(start_page: StartService, open_page: OpenPage) -> None:
    service = start_page()
    service.post(batch_of([0.0, 0.0, 0.0], sequence=1))
    service.post(batch_of(sequence=2))
    seen = open_page(service.url)
    assert_locked(seen)
    assert seen.text("token-error") == ""
    assert not seen.page.is_visible("#forget")

    enter(seen, WRONG)
    seen.wait_for_text("token-error", "This token is not accepted")
    assert seen.page.get_by_role("alert").inner_text() == "This token is not accepted"
    assert seen.page.get_attribute("#token", "aria-invalid") == "true"
    assert seen.page.evaluate(KEPT) == [0, 0]
    assert_locked(seen)

    enter(seen, READ_TOKEN)
    assert_open(seen)
    assert seen.page.input_value("#token") == ""
    seen.page.wait_for_selector("#events tr")
    assert seen.page.is_visible("#with-token")
    # It goes on: the figures follow what arrives.
    for sequence, row in enumerate(([0.25, 0.5, 0.0], [0.25, 0.5, 0.25]), start=3):
        service.post(batch_of(row, sequence=sequence))
        position = service.get("/contact", token=READ_TOKEN).json()["position_mm"]
        seen.wait_for_text("position", f"{position:.1f}")
    service.post(batch_of(sequence=5))

    seen.page.reload()
    assert_open(seen)
    seen.page.click("text=Forget token")
    assert_locked(seen)
    assert not seen.page.is_visible("#forget")
    seen.page.reload()
    assert_locked(seen)
    assert_only_refusals(seen)


def test_nothing_is_shown_once_the_token_is_forgotten_even_without_an_answer(
    start_page: StartService, open_page: OpenPage
) -> None:
    service = start_page()
    service.post(batch_of())
    seen = open_page(service.url)
    enter(seen, READ_TOKEN)
    assert_open(seen)
    service.stop(signal.SIGTERM)
    seen.page.click("text=Forget token")
    seen.wait_for_state("lost")
    assert (seen.text("position"), seen.text("surface"), seen.text("model")) == (NO_FIGURE, "", "")
    assert seen.page.evaluate(KEPT) == [0, 0]


def test_what_cannot_be_a_token_is_not_sent(start_page: StartService, open_page: OpenPage) -> None:
    service = start_page()
    for text in ("", "   ", "two words that are long enough", "tökén-ünd-nöch-étwas-😀"):
        seen = open_page(service.url)
        seen.wait_for_state("locked")
        asked = len(seen.requests)
        enter(seen, text)
        if text:
            seen.wait_for_text("token-error", "This token is not accepted")
        assert_locked(seen)
        assert len(seen.requests) == asked, text
        assert_only_refusals(seen)


def test_it_is_kept_for_the_session_or_for_the_device(start_page: StartService, open_page: OpenPage) -> None:
    service = start_page()
    service.post(batch_of())
    seen = open_page(service.url)
    enter(seen, READ_TOKEN)
    assert_open(seen)
    assert seen.page.evaluate(KEPT) == [1, 0]
    assert_locked(seen.beside())

    seen.page.click("text=Forget token")
    enter(seen, READ_TOKEN, keep=True)
    assert_open(seen)
    assert seen.page.evaluate(KEPT) == [0, 1]
    beside = seen.beside()
    assert_open(beside)
    # Whoever signs out means the device, not the window.
    beside.page.click("text=Forget token")
    assert_locked(beside)
    assert_locked(seen)
    assert seen.page.evaluate(KEPT) == [0, 0]


def test_a_service_that_comes_back_with_another_token(start_page: StartService, open_page: OpenPage) -> None:
    service = start_page()
    service.post(batch_of())
    seen = open_page(service.url)
    enter(seen, READ_TOKEN)
    assert_open(seen)
    seen.watch()

    other = again(start_page, service, OTHER)
    other.post(batch_of())
    assert_locked(seen)
    seen.wait_for_text("token-error", "The token kept here is not accepted any more")
    assert seen.page.is_visible("#forget")
    enter(seen, OTHER)
    assert_open(seen)
    assert seen.states()[:2] == ["lost", "locked"]
    assert seen.wrongs() == []

    # And with none at all: it goes on without a question.
    opened = again(start_page, other, None)
    opened.post(batch_of())
    seen.page.wait_for_function("() => window.states.filter(state => state === 'lost').length > 1")
    assert_open(seen)


def test_without_a_token_for_reading_there_is_no_form(start_page: StartService, open_page: OpenPage) -> None:
    service = start_page(read=None)
    service.post(batch_of())
    seen = open_page(service.url)
    seen.page.evaluate(
        f"() => {{ window.forms = 0; new MutationObserver(() => forms++)"
        f".observe(document.querySelector('{FORM}'), {{attributes: true}}); }}"
    )
    seen.watch()
    assert_open(seen)
    restarted = again(start_page, service, None)
    seen.wait_for_text("headline", "no samples yet")
    restarted.post(batch_of())
    assert_open(seen)
    assert seen.page.evaluate("() => window.forms") == 0
    assert "locked" not in seen.states()
    assert not seen.page.is_visible("#forget")
    assert not seen.page.is_visible("#with-token")
