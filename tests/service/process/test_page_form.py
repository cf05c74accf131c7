"""The form for the token in a real browser: keyboard, screen reader, contrast, sizes."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from service.conftest import READ_TOKEN, batch_of
from service.process.token_page import KEPT, WRONG, assert_open, enter

if TYPE_CHECKING:
    from browser import OpenPage
    from service.process.conftest import StartService

SIZES = {"desk": (1000, 900), "panel": (800, 480), "phone": (390, 844)}


def test_by_keyboard_alone(start_page: StartService, open_page: OpenPage) -> None:
    service = start_page()
    service.post(batch_of())
    seen = open_page(service.url)
    seen.wait_for_state("locked")
    where = "() => document.activeElement.id || document.activeElement.textContent"
    seen.page.wait_for_function(f"() => ({where})() === 'token'")
    seen.page.keyboard.type(WRONG)
    seen.page.keyboard.press("Enter")
    seen.wait_for_text("token-error", "not accepted")
    assert seen.page.evaluate(where) == "token"
    # The wrong one is selected, so that typing replaces it.
    seen.page.keyboard.type(READ_TOKEN)
    reached = []
    for _ in range(2):
        seen.page.keyboard.press("Tab")
        reached.append(seen.page.evaluate(where))
        outline = "() => getComputedStyle(document.activeElement).outlineStyle"
        assert seen.page.evaluate(outline) == "solid"
    assert reached == ["keep", "Show the page"]
    seen.page.keyboard.press("Shift+Tab")
    seen.page.keyboard.press("Space")
    seen.page.keyboard.press("Tab")
    seen.page.keyboard.press("Enter")
    assert_open(seen)
    assert seen.page.evaluate(KEPT) == [0, 1]
    seen.page.focus("#forget")
    seen.page.keyboard.press("Enter")
    seen.page.wait_for_function(f"() => ({where})() === 'token'")


def test_the_form_and_the_button_fit_and_can_be_read(start_page: StartService, open_page: OpenPage) -> None:
    service = start_page()
    service.post(batch_of())
    for name, scheme in product(SIZES, ("light", "dark")):
        size = SIZES[name]
        seen = open_page(service.url, size=size, color_scheme=scheme)
        seen.wait_for_state("locked")
        seen.picture(f"token-{name}-{scheme}")
        enter(seen, WRONG)
        seen.wait_for_text("token-error", "not accepted")
        seen.picture(f"token-wrong-{name}-{scheme}")
        found = seen.contrasts()
        assert len(found) >= 6
        assert [(text, ratio) for text, ratio in found if ratio < 4.5] == [], (name, scheme)
        assert seen.overflow() <= 0, (name, scheme)
        for element in ("headline", "token", "token-error", "keep", "token-form"):
            box = seen.page.locator(f"#{element}").bounding_box()
            assert box is not None
            assert box["x"] >= 0, (name, scheme, element)
            assert box["x"] + box["width"] <= size[0], (name, scheme, element)
            assert box["y"] + box["height"] <= size[1], (name, scheme, element)

        enter(seen, READ_TOKEN)
        assert_open(seen)
        seen.picture(f"token-used-{name}-{scheme}")
        assert seen.overflow() <= 0, (name, scheme)
        # The button takes no room from what matters.
        box = seen.page.locator("#force-strip").bounding_box()
        assert box is not None
        assert name == "phone" or box["y"] + box["height"] <= size[1], (name, scheme)
        seen.page.close()
