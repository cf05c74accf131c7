"""What tests of the page with a token for reading do again and again."""

from __future__ import annotations

import re
import signal
from typing import TYPE_CHECKING

from browser import NO_FIGURE

if TYPE_CHECKING:
    from browser import Watched
    from service.process.conftest import Service, StartService

WRONG = "a-wrong-token-that-someone-mistyped"
FORM = "#token-form"
KEPT = "() => [sessionStorage.length, localStorage.length]"


def again(start: StartService, service: Service, read: str | None) -> Service:
    """End the service and start it on the same port with another token for reading."""
    service.stop(signal.SIGTERM)
    return start("--port", service.url.rpartition(":")[2], read=read)


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


def assert_only_refusals(seen: Watched) -> None:
    """The browser notes each refused request by itself; nothing else went wrong, nothing came from elsewhere."""
    assert [text for text in seen.complaints if "status of 401" not in text] == []
    assert seen.strangers() == []
