"""The page in a real browser, on a service that is sent samples by hand: every state, keyboard, contrast."""

import json
import re
import signal
import time
from datetime import datetime, timedelta
from functools import partial
from itertools import count, pairwise
from pathlib import Path

import pytest

from service.bench import batch_of
from service.process.conftest import Service, StartService
from support.pages.browser import NO_FIGURE, SCREENS, OpenPage, Watched
from support.running.waiting import wait_until


def test_contact_degraded_and_too_few_channels(fresh: Service, open_page: OpenPage) -> None:
    seen = open_page(fresh.url)
    seen.wait_for_text("headline", "no samples yet")
    assert seen.text("position") == NO_FIGURE
    assert len(seen.page.query_selector_all("#beam rect.unknown")) == 3

    fresh.post(batch_of([0.5, 0.25, 0.125], sequence=1))
    seen.wait_for_state("contact")
    assert (seen.text("headline"), seen.text("position"), seen.text("detail")) == ("Contact", "150.0", "")
    assert seen.text("position-interval") == "149.0 … 151.0 (95 %)"
    cells = seen.page.query_selector_all("#channels td:nth-child(3)")
    assert [cell.inner_text() for cell in cells] == ["0.500", "0.250", "0.125"]
    assert "times larger" in seen.text("beam-words")

    fresh.post(batch_of([0.5, 0.25, None], sequence=2, quality=["good", "good", "stuck"]))
    seen.wait_for_text("detail", "Degraded: without s3")
    seen.wait_for_text("channels", "stuck")
    assert seen.page.query_selector("#beam text.bad") is not None
    # Two channels fit any contact.
    said = r"Contact at \d+ mm\. Degraded: without s3\. Too few sensors to tell a single contact from anything else"
    assert re.fullmatch(said, seen.text("status"))

    fresh.post(batch_of([0.5, None, None], sequence=3, quality=["good", "missing", "saturated"]))
    seen.wait_for_state("problem")
    assert seen.text("headline") == "Too few working channels"
    assert "Check s2 (missing), s3 (saturated)" in seen.text("detail")
    assert seen.text("position") == NO_FIGURE
    assert "saturated" in seen.text("channels")
    assert seen.unreadable() == []
    # Without a read token, nothing asks for one.
    assert not seen.page.is_visible("#token-form, #forget, #with-token")
    assert seen.complaints == []


def test_no_surface_no_model_and_one_that_is_not_there(
    start_service: StartService, tmp_path: Path, open_page: OpenPage
) -> None:
    nothing = open_page(start_service().url)
    nothing.wait_for_text("headline", "The service has no surface")

    (tmp_path / "service.toml").write_text("[surfaces.press-7]\n[surfaces.press-8]\n")
    service = start_service("--config", "service.toml")
    seen = open_page(service.url, "/?surface=press-9")
    seen.page.emulate_media(reduced_motion="reduce")  # two steps a second: it may see no other state between
    seen.wait_for_text("headline", "There is no surface “press-9”")
    assert "press-7, press-8" in seen.text("detail")
    seen.page.select_option("#chooser", "press-8")
    seen.wait_for_text("headline", "The surface has no model")
    assert seen.text("position") == NO_FIGURE
    seen.page.wait_for_url("**/?surface=press-8")
    seen.page.select_option("#chooser", "press-7")
    seen.page.wait_for_function("() => document.title.includes('press-7')")
    seen.page.go_back()
    seen.page.wait_for_function("() => document.title.includes('press-8')")
    assert seen.page.input_value("#chooser") == "press-8"
    linked = open_page(service.url, "/?surface=press-8")
    linked.wait_for_text("headline", "The surface has no model")
    assert any("/surfaces/press-8/stream" in url for url in linked.requests)
    assert not any("/surfaces/press-7/stream" in url for url in linked.requests)
    assert nothing.complaints + seen.complaints == []


@pytest.mark.parametrize("address", ["**/surfaces", "**/stream"])
def test_a_service_that_refuses_is_not_a_lost_connection(fresh: Service, open_page: OpenPage, address: str) -> None:
    problem = {"type": "urn:beamtouch:problem:too-many-clients", "title": "Too many clients", "detail": "Close one."}
    seen = open_page(fresh.url)
    answer = {"status": 503, "content_type": "application/problem+json", "body": json.dumps(problem)}
    seen.page.route(address, lambda route: route.fulfill(**answer))
    seen.page.reload()
    seen.wait_for_text("headline", "Too many clients")
    assert (seen.text("detail"), seen.text("position")) == ("Close one.", NO_FIGURE)


@pytest.mark.promise("docs/reference/page.md", "and works with the keyboard")
def test_the_keyboard_reaches_everything_and_shows_where_it_is(
    start_service: StartService, tmp_path: Path, open_page: OpenPage
) -> None:
    (tmp_path / "service.toml").write_text("[surfaces.press-7]\n[surfaces.press-8]\n")
    seen = open_page(start_service("--config", "service.toml").url)
    seen.wait_for_state("problem")
    assert "chooser" in seen.tab_through()

    seen.page.focus("#chooser")
    seen.page.keyboard.press("ArrowDown")
    seen.page.wait_for_url("**/?surface=press-8")
    seen.page.focus("summary")
    seen.page.keyboard.press("Enter")
    assert seen.page.is_visible("text=The large figures are the newest contact")


_LISTEN = """() => { window.said = []; const status = document.getElementById("status");
  new MutationObserver(() => said.push([performance.now(), status.textContent]))
    .observe(status, {childList: true, characterData: true, subtree: true}); }"""


@pytest.mark.promise(
    "docs/reference/page.md",
    "The reader announces each change of state, and a new position when the interval no longer contains the last one.",
)
def test_what_is_announced_follows_the_contact_and_not_every_sample(fresh: Service, open_page: OpenPage) -> None:
    seen = open_page(fresh.url)
    seen.wait_for_text("status", "no samples yet")
    seen.page.evaluate(_LISTEN)
    # A contact that trembles within its interval, then slides: twenty places in a second or more.
    for step in range(20):
        fresh.post(batch_of([0.5, 0.25 + 0.002 * (step % 2), 0.125], sequence=1 + step))
        time.sleep(0.02)
    seen.wait_for_text("status", "Contact at 150 mm")
    for step in range(20):
        fresh.post(batch_of([0.5, 0.25 + 0.01 * step, 0.125], sequence=100 + step))
        time.sleep(0.02)
    # However slow the machine is, the last place is not within the interval of one that was announced on the way.
    fresh.post(batch_of([0.25, 0.5, 0.25], sequence=150))
    final = fresh.get("/contact").json()["position_mm"]
    assert final > 190
    seen.wait_for_text("status", f"Contact at {final:.0f} mm")
    assert seen.page.get_attribute("#beam", "aria-labelledby") == "status beam-words"
    fresh.post(batch_of([0.0, 0.0, 0.0], sequence=200))
    seen.wait_for_state("clear")

    moments = seen.page.evaluate("() => window.said")
    texts = [text for _, text in moments]
    assert (texts[0], texts[-2:]) == ("Contact at 150 mm", [f"Contact at {final:.0f} mm", "Clear"])
    # A new state is announced at once, a new place of the same contact after three seconds at the earliest.
    assert all(later - earlier > 2900 for (earlier, _), (later, _) in pairwise(moments[:-1]))
    assert seen.page.get_attribute("#status", "aria-live") == "polite"
    assert seen.page.title() == "Clear · press-7 · Beamtouch"


@pytest.mark.soak
def test_what_waited_while_the_page_slept_is_not_taken_for_new(fresh: Service, open_page: OpenPage) -> None:
    fresh.post(batch_of())
    seen = open_page(fresh.url, is_patient=False)
    seen.wait_for_state("contact")
    seen.watch()
    seen.page.evaluate("() => { const end = performance.now() + 4000; while (performance.now() < end); }")
    # On a starved machine it may have lost the service before, and may lose it again.
    seen.page.wait_for_function("() => window.states.at(-1) === 'contact'")
    states = seen.states()
    assert states == ["lost", "contact"] * (len(states) // 2)
    assert seen.wrongs() == []


def durations(seen: Watched) -> list[str]:
    script = "rows => rows.map(row => row.cells[3].textContent)"
    found: list[str] = seen.page.eval_on_selector_all("#events tr", script)
    return found


@pytest.mark.promise("docs/reference/page.md", "An event that did not begin today is shown with its day.")
def test_an_event_of_another_day_is_shown_with_it(fresh: Service, open_page: OpenPage) -> None:
    fresh.post(batch_of([0.0, 0.0, 0.0], [0.5, 0.25, 0.125]))
    seen = open_page(fresh.url, often=("events",), timezone_id="UTC")
    seen.page.wait_for_selector("#events tr")
    began = datetime.fromisoformat(seen.page.get_attribute("#events time", "datetime") or "")

    def is_shown(wanted: str) -> bool:
        return seen.page.inner_text("#events time") == wanted

    def shown_at(now: datetime, wanted: str) -> None:
        seen.page.clock.set_fixed_time(now)
        wait_until(partial(is_shown, wanted), pause_s=0.1)

    clock = f"{began:%H:%M:%S}"
    shown_at(began, clock)
    shown_at(began + timedelta(days=1), f"{began:%-d %b}, {clock}")
    shown_at(began + timedelta(days=400), f"{began:%-d %b %Y}, {clock}")
    shown_at(began, clock)


def test_the_contact_of_a_sender_that_fell_silent_is_shown_as_ended(
    start_press: StartService, open_page: OpenPage
) -> None:
    service = start_press(stale_ms=500)
    seen = open_page(service.url)
    service.post(batch_of([0.0, 0.0, 0.0], [0.5, 0.25, 0.125]))
    seen.wait_for_text("headline", "Stale")
    seen.wait_for_text("events", "≥")
    assert durations(seen) == ["≥ 0.0"]
    title, detail, channels, *figures = seen.texts_in("problem", "detail", "channels", "position", "force")
    assert title.startswith("Stale")
    assert "ms old" in detail
    assert "not known" in channels
    assert figures == [NO_FIGURE, NO_FIGURE]


def test_without_a_connection_no_contact_is_shown_as_going_on(fresh: Service, open_page: OpenPage) -> None:
    fresh.post(batch_of([0.0, 0.0, 0.0], [0.5, 0.25, 0.125]))
    seen = open_page(fresh.url)
    seen.wait_for_text("events", "still")
    fresh.process.kill()
    seen.wait_for_state("lost")
    assert durations(seen) == ["≥ 0.0"]
    assert re.fullmatch(r"No connection since \d\d:\d\d:\d\d [A-Z]{3}\S*", seen.text("headline")), "with the zone"
    assert seen.page.title().startswith("No connection")
    assert (seen.text("position"), seen.text("age")) == (NO_FIGURE, NO_FIGURE)


@pytest.mark.promise("docs/reference/page.md", "Every figure that is older than the surface's limit is shown as “—”.")
def test_no_figure_stays_while_the_service_hangs_whether_or_not_the_page_gives_it_up(
    start_press: StartService, open_page: OpenPage
) -> None:
    service = start_press(stale_ms=3000)
    seen = {"silent": open_page(service.url), "lost": open_page(service.url, is_patient=False)}
    numbers = count(1)

    def is_touched() -> bool:
        """Send a sample; return whether all pages show a contact."""
        assert service.post(batch_of(sequence=next(numbers))).status_code == 200
        return all(one.figures()["state"] == "contact" for one in seen.values())

    wait_until(is_touched, pause_s=0.2)
    for one in seen.values():
        one.watch()
    service.process.send_signal(signal.SIGSTOP)
    try:
        for state, one in seen.items():
            one.wait_for_state(state)
            assert one.text("position") == NO_FIGURE
    finally:
        service.process.send_signal(signal.SIGCONT)
    wait_until(is_touched, pause_s=0.2)
    assert [one.wrongs() for one in seen.values()] == [[], []]


DIGITS_PX = "() => parseFloat(getComputedStyle(document.getElementById('position')).fontSize)"
LOWEST_PX = """() => Math.max(...["position", "force", "age", "beam", "position-strip", "force-strip"]
  .map(id => document.getElementById(id).getBoundingClientRect().bottom))"""
CUT_OFF_PX = "name => { const one = document.querySelector(name); return one.scrollWidth - one.clientWidth; }"


def test_a_contact_fits_on_every_screen_and_can_be_read(fresh: Service, open_page: OpenPage) -> None:
    resting, touching = [0.0, 0.0, 0.0], [0.5, 0.25, 0.125]
    fresh.post(batch_of(resting, touching, resting, touching))
    for name, size, scheme in SCREENS:
        seen = open_page(fresh.url, size=size, color_scheme=scheme)
        seen.wait_for_state("contact")
        seen.page.wait_for_selector("#events tr")
        seen.picture(name)
        assert seen.overflow() <= 0, name
        if name == "phone":
            # No column of a table is cut off.
            for table in ("#channels", ".scroll"):
                assert seen.page.evaluate(CUT_OFF_PX, table) <= 0, table
        if name == "panel":
            # At arm's length: digits have more than 5 mm on a panel of 7 inches, and both charts are on it.
            assert seen.page.evaluate(DIGITS_PX) >= 48
            assert seen.page.evaluate(LOWEST_PX) <= 480
            fresh.post(batch_of(resting, sequence=5))
            seen.wait_for_state("clear")
            assert seen.page.evaluate(LOWEST_PX) <= 480
            fresh.post(batch_of(touching, sequence=6))
        seen.page.click("summary")
        assert seen.unreadable(least_texts=31) == [], name
        seen.page.close()
