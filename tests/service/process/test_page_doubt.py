"""What the page says where an answer is doubtful: the state unexplained, and the notes in words."""

import re

import numpy as np
import pytest

from service.process.beam_page import StartBench, circles, drawn
from support.pages.browser import NO_FIGURE, SCREENS, OpenPage, Watched

TWO = ((100, 8), (300, 8))
"""Two contacts, in mm and N."""


def assert_no_contact_is_shown(seen: Watched) -> None:
    assert (seen.text("position"), seen.text("force")) == (NO_FIGURE, NO_FIGURE)
    assert (seen.text("position-interval"), seen.text("force-interval")) == ("", "")
    assert seen.page.query_selector("#beam :is(.touch, .bar, .here, .bent, .guessed)") is None


@pytest.mark.promise(
    "docs/reference/page.md",
    "The page shows no position, no force and no shape, only the measured points, and says what to look at",
)
def test_two_contacts_are_unexplained_and_say_what_to_look_at(start_bench: StartBench, open_page: OpenPage) -> None:
    bench = start_bench()
    bench.load((150, 9))
    seen = open_page(bench.service.url)
    seen.wait_for_state("contact")
    assert re.fullmatch(r"Misfit [\d.]+, the limit is [\d.]+", seen.text("misfit"))
    seen.watch()
    bench.load(*TWO)
    seen.wait_for_state("unexplained")
    seen.wait_for_text("misfit", "over the limit of")
    assert (seen.text("headline"), seen.page.title()) == ("Unexplained", "Unexplained · press-7 · Beamtouch")
    for part in ("not a single contact, or a sensor is wrong", "more than one thing touches", "wedged under it"):
        assert part in seen.text("detail")
    assert seen.text("status").startswith("Unexplained. Something acts on the beam")
    assert seen.page.query_selector("#sign svg") is not None
    assert_no_contact_is_shown(seen)
    # The measured points are there, joined by straight lines that claim no shape.
    assert np.array(drawn(seen, "doubt")) == pytest.approx(np.array(circles(seen)))
    assert len(circles(seen)) == 4
    assert "not known" in seen.text("beam-words")
    seen.page.wait_for_selector("#position-strip rect.unexplained", state="attached")

    bench.load((150, 9))
    seen.wait_for_state("contact")
    bench.load(*TWO)
    seen.wait_for_state("unexplained")
    bench.load()
    seen.wait_for_state("clear")
    assert seen.wrongs() == []
    assert seen.complaints == []


def test_a_stretch_whose_end_was_seen_lasted_as_long_as_it_says(start_bench: StartBench, open_page: OpenPage) -> None:
    bench = start_bench()
    for loads in ((), TWO, (), TWO, ((150, 9),), (), TWO):
        bench.load(*loads)
    bench.send([None] * 4)
    seen = open_page(bench.service.url)
    seen.page.wait_for_selector("#events tr:nth-child(4)")
    cells = "rows => rows.map(row => [...row.cells].slice(1).map(cell => cell.textContent))"
    stretch, contact, before, first = seen.page.eval_on_selector_all("#events tr", cells)
    assert [one[0] for one in (stretch, before, first)] == ["unexplained"] * 3
    assert [one[1].startswith("≥ 0.") for one in (stretch, before, first)] == [True, False, False]
    assert re.fullmatch(r"0\.\d", contact[2])


@pytest.mark.promise("docs/reference/page.md", "first the sensor of `check-NAME`.")
def test_a_sensor_that_contradicts_the_others_is_named_first(start_bench: StartBench, open_page: OpenPage) -> None:
    bench = start_bench()
    bench.load()
    seen = open_page(bench.service.url)
    seen.wait_for_state("clear")
    bench.wedge(2)
    seen.wait_for_text("detail", "Sensor s3 contradicts the others: check it first")
    assert seen.text("detail").startswith("Sensor s3")
    seen.wait_for_text("channels", "check first")
    words = seen.page.eval_on_selector_all("#channels td.words", "all => all.map(one => one.textContent)")
    assert words == ["good", "good", "check first", "good"]
    assert seen.page.text_content("#beam text.suspect") == "check s3"
    assert len(seen.page.query_selector_all("#beam circle.suspect")) == 1
    # Once the state has been said, so is that.
    seen.wait_for_text("status", "Sensor s3 contradicts the others")
    assert_no_contact_is_shown(seen)
    bench.load()
    seen.wait_for_state("clear")
    assert "check" not in seen.text("channels")
    assert seen.page.query_selector("#beam .suspect") is None


@pytest.mark.promise("docs/reference/page.md", "All notes stand in words beside the state.")
def test_notes_stand_in_words(start_bench: StartBench, open_page: OpenPage) -> None:
    bench = start_bench()
    bench.load((100, 40))
    seen = open_page(bench.service.url)
    seen.wait_for_text("detail", "The force is beyond the range of the scene")
    seen.wait_for_text("status", "Contact at 100 mm. The force is beyond the range of the scene")
    left = bench.deflection_mm((150, 9))
    bench.send([None, left[1], left[2], None])
    seen.wait_for_text("detail", "Too few sensors to tell a single contact from anything else")
    assert seen.text("detail").startswith("Degraded: without s1, s4. ")
    bench.load((150, 9), noise_mm=[1e-5] * 4, notes=["rate"])
    seen.wait_for_text("detail", "The sender states another noise than the model was made for")
    assert "The device does not keep its rate" in seen.text("detail")
    assert seen.complaints == []


@pytest.mark.soak
def test_doubt_can_be_read_on_every_screen(start_bench: StartBench, open_page: OpenPage) -> None:
    bench = start_bench()
    bench.wedge(2)
    for name, size, scheme in SCREENS:
        seen = open_page(bench.service.url, size=size, color_scheme=scheme)
        seen.wait_for_text("detail", "Sensor s3")
        seen.page.wait_for_selector("#beam .support", state="attached")
        seen.picture(f"unexplained-{name}-{scheme}")
        assert (seen.unreadable(), seen.overflow() <= 0) == ([], True), name
        assert seen.outside("headline", "detail", "beam") == [], name
        seen.page.close()


@pytest.mark.promise("docs/reference/page.md", "If the page itself fails, it shows no figures until it works again.")
def test_a_page_that_is_older_than_its_service_or_fails_shows_no_figure_and_recovers(
    start_bench: StartBench, open_page: OpenPage
) -> None:
    bench = start_bench()
    bench.load((150, 9))
    seen = open_page(bench.service.url)
    seen.wait_for_state("contact")
    seen.watch()
    for headline, broken, mended in (
        (
            "This page is older than the service",
            "window.parse = JSON.parse; JSON.parse = text => { const message = parse(text);"
            " if (message.contact) message.contact.state = 'novel'; return message; };",
            "JSON.parse = window.parse;",
        ),
        (
            "This page has failed",
            "Element.prototype.kept = Element.prototype.replaceChildren;"
            " Element.prototype.replaceChildren = () => { throw new Error('broken'); };",
            "Element.prototype.replaceChildren = Element.prototype.kept;",
        ),
    ):
        seen.page.evaluate(f"() => {{ {broken} }}")
        seen.wait_for_text("headline", headline)
        assert seen.text("position") == NO_FIGURE
        # It goes on: the next answer that it knows is shown.
        seen.page.evaluate(f"() => {{ {mended} }}")
        seen.wait_for_state("contact")
    assert seen.wrongs() == []
