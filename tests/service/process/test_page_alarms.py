"""The list of alarms on the page: what is out now on any surface, since when, and what to do."""

import re
from functools import partial

import pytest

from service.process.beam_page import StartBench
from support.pages.browser import OpenPage
from support.running.waiting import wait_until

ZONE = "Europe/Berlin"


@pytest.mark.promise("docs/reference/page.md", "what is out on any surface of the service, since when, and what to do")
def test_alarms_say_what_is_out_since_when_in_which_zone_and_what_to_do(
    start_bench: StartBench, open_page: OpenPage
) -> None:
    bench = start_bench(sections="degraded_after_s = 0.2")
    bench.load()
    seen = open_page(bench.service.url, timezone_id=ZONE)
    seen.wait_for_state("clear")
    assert not seen.page.is_visible("#alarms-section")

    def is_told(wanted: str = "") -> bool:
        bench.send([0.0, None, 0.0, 0.0])  # on and on: a surface without samples has another alarm
        text = seen.text("alarms")
        return "press-7: Sensors have failed" in text and re.search(wanted, text) is not None

    wait_until(is_told, pause_s=0.1)
    text = " ".join(seen.text("alarms").split())
    # By the clock of the samples, whose time is stated in UTC.
    assert re.search(r"since 21 Nov 2026,? (at )?00:40:46 (CET|GMT\+1)", text), text
    assert "The contact is found without s2 (missing since 2026-11-20T23:40:46" in text
    assert "Check it." in text
    for today, since in (("2026-11-21", "00:40:46"), ("2026-11-22", "21 Nov 2026,? (at )?00:40:46")):
        seen.page.clock.set_fixed_time(f"{today}T12:00Z")  # a panel is not loaded again at midnight
        wait_until(partial(is_told, f"since {since}"), pause_s=0.1)
    assert seen.unreadable() == []
    assert seen.complaints == []
