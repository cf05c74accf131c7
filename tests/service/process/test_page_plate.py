"""The page of a plate in a real browser: seen from above and to scale, on a desk and on a phone."""

from typing import Any

import pytest

from service.bench import START_US, TOKEN, BuildModel, Row, batch_of
from service.process.conftest import Service, StartService
from support.pages.browser import OpenPage, Watched
from support.surfaces.small_model import PLATE_OUTPUTS

RESTING: Row = [0.0] * 4
TOUCHING: Row = [0.5, 0.25, 0.125, 0.0]
"""At x = 150 and y = 75 mm, 8.75 N, with a correlation of 0.4375; both intervals are 2 mm wide."""
HARDER: Row = [0.5, 0.75, 0.5, 0.0]
"""At x = 275 and y = 137.5 mm."""
ZONES = """
[surfaces.press-7.zones.near]
x_mm = [140, 260]
y_mm = [40, 120]
[surfaces.press-7.zones.far]
x_mm = [280, 380]
y_mm = [150, 280]
"""
HEADINGS = ["Began at, UTC", "Mean at, mm", "Mean force, N", "For, s"]
LENGTH_MM, WIDTH_MM = 400, 300
PIXEL = 0.6
_BOXES = """selectors => selectors.map(selector => [...document.querySelectorAll(`#beam ${selector}`)].map(one => {
  const {x, y, width, height} = one.getBBox(); return [x, y, width, height]; }))"""

_APART = """ids => {
  const boxes = ids.map(id => {
    const range = document.createRange(); range.selectNodeContents(document.getElementById(id));
    return range.getBoundingClientRect(); });
  return ids.filter((_, i) => boxes.some((other, j) => i !== j && other.left < boxes[i].right
    && boxes[i].left < other.right && other.top < boxes[i].bottom && boxes[i].top < other.bottom)); }"""
"""Returns the ids of the texts that lie on others."""


def send(service: Service, *rows: Row, sequence: int) -> None:
    begin_us = START_US + 5000 * sequence
    assert service.post(batch_of(*rows, sequence=sequence, begin_us=begin_us)).status_code == 200


def boxes(seen: Watched, *selectors: str) -> list[list[list[float]]]:
    """Return what is drawn at one moment: a drawing that has been replaced has no extent."""
    found: list[list[list[float]]] = seen.page.evaluate(_BOXES, selectors)
    return found


def place_of(seen: Watched, selector: str) -> list[tuple[float, float]]:
    """Return the middles of what is drawn [mm], by the plate as it is drawn."""
    ((left, top, width, height),), drawn = boxes(seen, "rect.plate", selector)
    per_mm = width / LENGTH_MM
    assert height / per_mm == pytest.approx(WIDTH_MM)
    return [((x + wide / 2 - left) / per_mm, WIDTH_MM - (y + high / 2 - top) / per_mm) for x, y, wide, high in drawn]


def region(seen: Watched, selector: str) -> list[float]:
    """Return width and height of the region of the contact [mm]."""
    ((_, _, px, _),), ((_, _, width, height),) = boxes(seen, "rect.plate", selector)
    return [width * LENGTH_MM / px, height * LENGTH_MM / px]


def near(*places: tuple[float, float]) -> list[Any]:
    return [pytest.approx(place, abs=2 * PIXEL) for place in places]


@pytest.mark.promise(
    "docs/reference/contact.md",
    "with the two intervals it makes the ellipse that holds 95 % of such contacts, as the page draws it",
)
@pytest.mark.parametrize(("name", "size"), [("desk", (1280, 900)), ("phone", (390, 844)), ("panel", (800, 480))])
def test_a_plate_is_drawn_from_above_to_scale(
    start_press: StartService, build_model: BuildModel, open_page: OpenPage, name: str, size: tuple[int, int]
) -> None:
    service = start_press(model=build_model(outputs=PLATE_OUTPUTS, channels=4), sections=ZONES)
    send(service, RESTING, *[TOUCHING] * 3, *[HARDER] * 5, RESTING, RESTING, *[TOUCHING] * 5, sequence=1)
    seen = open_page(service.url, size=size)
    seen.watch()
    seen.wait_for_state("contact")
    seen.page.wait_for_selector("#beam rect.zone.inside", state="attached")
    assert (seen.text("x-name"), seen.text("x"), seen.text("y")) == ("x", "150.0", "75.0")
    assert (seen.text("x-interval"), seen.text("force")) == ("149.0 … 151.0 (95 %)", "8.8")
    seen.wait_for_text("status", "Contact at 150, 75 mm")
    assert place_of(seen, "circle.tip") == near((150, 75))
    assert place_of(seen, "rect.sensor") == near((100, 50), (200, 150), (300, 250), (400, 50))
    assert place_of(seen, "rect.zone") == near((200, 80), (330, 215))
    assert place_of(seen, "circle.support.spring") == near((0, 0))
    assert place_of(seen, "path.support.line") == near((200, 290))
    # By hand: 1 mm is 1.96 deviations, and a circle of 2.4477 of them holds 95 %.
    assert region(seen, "polygon.bar") == pytest.approx([2 * 2.4477 / 1.96] * 2, rel=0.05)
    assert "to scale" in seen.text("beam-words")
    assert "x 140 … 260, y 40 … 120 mm: inside" in seen.text("zones")
    seen.wait_for_text("events", "150.0 … 275.0, 75.0 … 137.5")
    assert seen.page.locator("#events-head th").all_inner_texts() == HEADINGS
    seen.page.wait_for_selector("#y-strip polyline", state="attached")
    assert (seen.overflow(), seen.wrongs(), seen.complaints, seen.strangers()) == (0, [], [], [])
    assert seen.unreadable() == []
    assert seen.page.evaluate(_APART, ["headline", "x", "y", "force", "age"]) == []
    seen.picture(f"plate-{name}")
    send(service, *[RESTING] * 3, sequence=30)
    seen.wait_for_state("clear")
    seen.page.wait_for_function("() => !document.querySelector('#beam .bar')")
    assert (seen.text("x"), seen.text("y")) == ("—", "—")


def test_without_a_correlation_the_intervals_make_a_box(
    start_press: StartService, build_model: BuildModel, open_page: OpenPage
) -> None:
    outputs = tuple(one for one in PLATE_OUTPUTS if one != "place_correlation")
    service = start_press(model=build_model(outputs=outputs, channels=4))
    send(service, *[TOUCHING] * 5, sequence=1)
    seen = open_page(service.url)
    seen.wait_for_state("contact")
    seen.page.wait_for_selector("#beam rect.bar", state="attached")
    assert region(seen, "rect.bar") == pytest.approx([2, 2])
    assert "the 95 % intervals of x and y" in seen.text("beam-words")
    send(service, *[[0.5, 0.0, 0.5, 0.0]] * 5, sequence=10)
    seen.wait_for_state("unexplained")
    seen.wait_for_text("detail", "Something acts on the plate")
    assert "beam" not in seen.text("detail")


def test_the_plate_shows_where_to_press(
    start_press: StartService, build_model: BuildModel, open_page: OpenPage
) -> None:
    service = start_press(model=build_model(outputs=PLATE_OUTPUTS, channels=4))
    send(service, *[RESTING] * 300, sequence=1)
    seen = open_page(service.url, size=(390, 844))
    seen.wait_for_state("clear")
    seen.page.click("#commissioning-open")
    seen.page.fill("#commissioning-token", TOKEN)
    seen.page.keyboard.press("Enter")
    seen.wait_for_text("commissioning-prompt", "Take everything off the plate")
    send(service, *[RESTING] * 300, sequence=301)
    seen.wait_for_text("commissioning-prompt", "Press above s1, at x 100 and y 50 mm")
    seen.page.wait_for_selector("#beam circle.target", state="attached")
    assert place_of(seen, "circle.target") == near((100, 50))
    seen.wait_for_text("commissioning-steps", "mark at 300, 224 mm")
    assert (seen.overflow(), seen.complaints) == (0, [])
    seen.page.evaluate("document.getElementById('commissioning').scrollIntoView()")
    seen.picture("plate-commissioning-phone")


def test_a_model_of_a_beam_takes_the_place_of_that_of_a_plate(
    start_press: StartService, build_model: BuildModel, open_page: OpenPage
) -> None:
    service = start_press(model=build_model(outputs=PLATE_OUTPUTS), stale_ms=5000)
    send(service, *[TOUCHING[:3]] * 3, sequence=1)
    seen = open_page(service.url)
    seen.page.wait_for_selector("#beam .support.spring", state="attached")
    seen.wait_for_state("problem")  # stale
    build_model()
    seen.page.wait_for_selector("#beam rect.plate", state="detached")
    assert seen.page.locator("#beam .support").count() == 0  # those of the beam come with its first contact
    send(service, *[TOUCHING[:3]] * 3, sequence=4)
    seen.wait_for_text("position-interval", "149.0 … 151.0")
    assert not seen.complaints, "\n".join(seen.complaints)
