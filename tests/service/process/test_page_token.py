"""The page of a service with a token for reading, in a real browser: what it shows to whom, and its form."""

import re
import signal

import pytest

from service.bench import READ_TOKEN, batch_of
from service.process.conftest import Service, StartService
from support.pages.browser import NO_FIGURE, SCREENS, OpenPage, Watched

WRONG = "a-wrong-token-that-someone-mistyped"
FORM = "#token-form"
FOCUSED = "() => document.activeElement.id === 'token'"
KEPT = "() => [sessionStorage.length, localStorage.length]"
OTHER = "another-token-since-the-restart"


def again(start: StartService, service: Service, read: str | None) -> Service:
    """End the service and start it on the same port with another token for reading."""
    service.stop(signal.SIGTERM)
    return start("--port", str(service.port), read=read)


def enter(seen: Watched, token: str, *, keep: bool = False) -> None:
    """Type a token in once the form is there."""
    seen.wait_for_state("locked")
    seen.page.get_by_role("textbox", name="Reading token").fill(token)
    seen.page.get_by_label("Keep on this device until I forget it").set_checked(keep)
    seen.page.get_by_role("button", name="Show the page").click()


def assert_locked(seen: Watched) -> None:
    """Nothing is there but the form: no figure, no name, no leftover of what was."""
    seen.wait_for_state("locked")
    assert seen.text("headline") == "A reading token is needed"
    assert seen.page.is_visible(FORM)
    assert re.search(r"\d", seen.page.inner_text("body")) is None
    for element in ("position", "force", "age"):
        assert seen.page.text_content(f"#{element}") == NO_FIGURE
    assert "press-7" not in seen.page.content()
    for element in ("channels", "events", "beam"):
        assert seen.page.locator(f"#{element} > *").count() == 0
    # The charts are drawn less often than the rest.
    seen.page.wait_for_function("() => document.querySelectorAll('.strip-line').length === 0")


def assert_open(seen: Watched) -> None:
    seen.wait_for_state("contact")
    assert seen.text("position") == "150.0"
    assert not seen.page.is_visible(FORM)


def unlocked(start_press: StartService, open_page: OpenPage) -> tuple[Service, Watched]:
    """Start a service with a contact, and open its page with the token."""
    service = start_press(read=READ_TOKEN)
    service.post(batch_of())
    seen = open_page(service.url)
    enter(seen, READ_TOKEN)
    assert_open(seen)
    return service, seen


def assert_only_refusals(seen: Watched) -> None:
    """The browser notes each refused request by itself; nothing else went wrong, nothing came from elsewhere.

    No token was in an address, which logs of servers keep.
    """
    assert [text for text in seen.complaints if "status of 401" not in text] == []
    assert seen.strangers() == []
    assert not [url for url in seen.requests if READ_TOKEN in url or WRONG in url]


@pytest.mark.promise(
    "docs/reference/page.md",
    "If the service has a read token, the page shows only a form until it has the right one.",
)
def test_it_opens_by_keyboard_with_the_right_token_and_then_follows_what_arrives(
    start_press: StartService, open_page: OpenPage
) -> None:
    service = start_press(read=READ_TOKEN)
    service.post(batch_of([0.0, 0.0, 0.0], sequence=1))
    service.post(batch_of(sequence=2))
    seen = open_page(service.url)
    assert_locked(seen)
    assert seen.text("token-error") == ""
    assert not seen.page.is_visible("#forget")
    seen.page.wait_for_function(FOCUSED)
    seen.tab_through()

    seen.page.focus("#token")
    seen.page.keyboard.type(READ_TOKEN)
    seen.page.keyboard.press("Enter")
    assert_open(seen)
    assert seen.page.input_value("#token") == ""
    seen.page.wait_for_selector("#events tr")
    assert seen.page.is_visible("#with-token")
    for sequence, row in enumerate(([0.25, 0.5, 0.0], [0.25, 0.5, 0.25]), start=3):
        service.post(batch_of(row, sequence=sequence))
        position = service.get("/contact", token=READ_TOKEN).json()["position_mm"]
        seen.wait_for_text("position", f"{position:.1f}")
    assert_only_refusals(seen)


@pytest.mark.promise(
    "docs/reference/page.md",
    "If the service has a read token, the page shows only a form until it has the right one.",
)
def test_a_wrong_token_is_refused_and_typing_replaces_it(start_press: StartService, open_page: OpenPage) -> None:
    service = start_press(read=READ_TOKEN)
    service.post(batch_of())
    seen = open_page(service.url)
    enter(seen, WRONG)
    seen.wait_for_text("token-error", "This token is not accepted")
    assert seen.page.get_by_role("alert").inner_text() == "This token is not accepted"
    assert seen.page.get_attribute("#token", "aria-invalid") == "true"
    assert seen.page.evaluate(KEPT) == [0, 0]
    assert_locked(seen)

    # The wrong one is selected.
    seen.page.wait_for_function(FOCUSED)
    seen.page.keyboard.type(READ_TOKEN)
    seen.page.keyboard.press("Enter")
    assert_open(seen)
    assert_only_refusals(seen)


def test_it_stays_open_when_loaded_anew_until_the_token_is_forgotten(
    start_press: StartService, open_page: OpenPage
) -> None:
    _, seen = unlocked(start_press, open_page)
    seen.page.reload()
    assert_open(seen)

    seen.page.click("text=Forget token")
    assert_locked(seen)
    assert not seen.page.is_visible("#forget")
    seen.page.reload()
    assert_locked(seen)
    assert_only_refusals(seen)


def test_nothing_is_shown_once_the_token_is_forgotten_even_without_an_answer(
    start_press: StartService, open_page: OpenPage
) -> None:
    service, seen = unlocked(start_press, open_page)
    service.stop(signal.SIGTERM)
    seen.page.click("text=Forget token")
    seen.wait_for_state("lost")
    assert (seen.text("position"), seen.text("surface"), seen.text("model")) == (NO_FIGURE, "", "")
    assert seen.page.evaluate(KEPT) == [0, 0]


@pytest.mark.soak
@pytest.mark.promise(
    "docs/reference/page.md",
    "it keeps it until “Forget token” is pressed in any window",
    "and keeps it until the window is closed.",
)
def test_it_is_kept_for_the_session_or_for_the_device(start_press: StartService, open_page: OpenPage) -> None:
    _, seen = unlocked(start_press, open_page)
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


def test_a_service_that_comes_back_with_another_token(start_press: StartService, open_page: OpenPage) -> None:
    service, seen = unlocked(start_press, open_page)
    seen.watch()

    other = again(start_press, service, OTHER)
    other.post(batch_of())
    assert_locked(seen)
    seen.wait_for_text("token-error", "The token kept here is not accepted any more")
    assert seen.page.is_visible("#forget")
    enter(seen, OTHER)
    assert_open(seen)
    assert seen.states()[:2] == ["lost", "locked"]
    assert seen.wrongs() == []

    # And with none at all: it goes on without a question.
    opened = again(start_press, other, None)
    opened.post(batch_of())
    seen.page.wait_for_function("() => window.states.filter(state => state === 'lost').length > 1")
    assert_open(seen)


@pytest.mark.soak
def test_the_form_and_the_button_fit_and_can_be_read(start_press: StartService, open_page: OpenPage) -> None:
    service = start_press(read=READ_TOKEN)
    service.post(batch_of())
    for name, size, scheme in SCREENS:
        seen = open_page(service.url, size=size, color_scheme=scheme)
        seen.wait_for_state("locked")
        seen.picture(f"token-{name}-{scheme}")
        enter(seen, WRONG)
        seen.wait_for_text("token-error", "not accepted")
        seen.picture(f"token-wrong-{name}-{scheme}")
        assert (seen.unreadable(), seen.overflow() <= 0) == ([], True), name
        assert seen.outside("headline", "token", "token-error", "keep", "token-form") == [], name

        enter(seen, READ_TOKEN)
        assert_open(seen)
        seen.picture(f"token-used-{name}-{scheme}")
        assert seen.overflow() <= 0, name
        # The button takes no room from what matters.
        assert name == "phone" or seen.outside("force-strip") == [], name
        seen.page.close()
