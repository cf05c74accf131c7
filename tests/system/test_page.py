"""The page in a real browser, with the whole line behind it, against the rig's own truth."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from browser import NO_FIGURE, OpenPage, Watched
from example_scenes import SCENES
from line import Line, Surface, Truth

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

PLACES = {120.0, 290.0}
SCRIPT = """
[[step]]
seconds = 5
position_mm = 120
force_n = 10
[[step]]
seconds = 5
[[step]]
seconds = 5
position_mm = 290
force_n = 15
"""
STEADY_S = 2.0
"""How long a load must have been there before what the page says is compared: it may draw late on a busy machine."""
COMPARE_S = 200.0
UNSTEADY = "The beam moves, or one sample does not settle the state"
# The height of the digits once there is a contact: a page without a figure has words in their place.
_DIGITS_PX = """() => document.body.dataset.state === "contact"
  && parseFloat(getComputedStyle(document.getElementById("position")).fontSize)"""
_LOWEST = """() => {
  const names = ["position", "force", "age", "beam", "position-strip", "force-strip"];
  const bottoms = names.map((id) => document.getElementById(id).getBoundingClientRect().bottom);
  return [Math.max(...bottoms), document.querySelector(".now").innerText, document.body.dataset.state];
}"""


@pytest.fixture
def start(tmp_path: Path, bench_model: Path) -> Iterator[Callable[..., Line]]:
    """A function that starts a line of surfaces of these names, all with the script; ended after the test."""
    started: list[Line] = []

    def start_line(*names: str) -> Line:
        (tmp_path / "script.toml").write_text(SCRIPT)
        config = tmp_path / "generated.toml"
        config.write_text(daemon_config(modelfile.load(bench_model).metadata))
        surfaces = [Surface(name, "modbus-tcp", tmp_path / "script.toml") for name in names]
        line = Line(tmp_path, SCENES / "bench.toml", bench_model, config, surfaces)
        line.__enter__()
        started.append(line)
        return line

    yield start_line
    for line in started:
        line.stop()


def compare(seen: Watched, truth: Truth) -> None:
    """Compare what the page says with what touches until every load of the script was seen."""
    compared: set[float | None] = set()
    deadline = time.monotonic() + COMPARE_S
    while compared != PLACES | {None}:
        assert time.monotonic() < deadline, compared
        said = seen.figures()
        seen.page.wait_for_timeout(50)  # the rig writes the truth every 10 ms
        truth.read()
        if said["state"] not in {"contact", "clear"} or not truth.steady(said["unix_s"], STEADY_S):
            continue
        load = truth.at(said["unix_s"])
        assert load is not None
        position, force = load
        if position is None:
            assert (said["state"], said["position"], said["force"]) == ("clear", NO_FIGURE, NO_FIGURE)
        elif said["state"] == "clear" and UNSTEADY in said["detail"]:
            continue  # the beam still rings; it rings the longer, the fewer readings a busy machine takes
        else:
            assert said["state"] == "contact"
            is_near = abs(float(said["position"]) - position) < 15 and abs(float(said["force"]) - force) < 2
            if UNSTEADY in said["detail"] and not is_near:
                continue
            assert is_near, (said, position, force)
            low, high = map(float, re.findall(r"[\d.]+", said["position-interval"])[:2])
            assert low <= float(said["position"]) <= high
        compared.add(position)


def test_from_contact_to_silence_and_back(start: Callable[..., Line], open_page: OpenPage) -> None:
    line = start("bench")
    seen = open_page(line.url)
    seen.watch()
    with closing(Truth(line.truth("bench"))) as truth:
        compare(seen, truth)
    assert seen.text("surface") == "bench"
    assert seen.complaints == []
    assert seen.strangers() == []

    (title,) = seen.texts_in("contact")
    assert title.startswith("Contact")
    assert line.end("daemon") == 0
    seen.page.wait_for_function("() => document.title.startsWith('Stale')")
    title, headline, detail, channels, *figures = seen.texts_in(
        "problem", "headline", "detail", "channels", "position", "force"
    )
    assert title.startswith("Stale")
    assert headline.startswith("Stale")
    assert "ms old" in detail
    assert "not known" in channels
    assert figures == [NO_FIGURE, NO_FIGURE]
    assert seen.page.query_selector("#bar") is None
    seen.picture("stale")

    line.end("service")
    seen.wait_for_state("lost")
    assert re.fullmatch(r"No connection since \d\d:\d\d:\d\d", seen.text("headline"))
    assert seen.page.title().startswith("No connection")
    assert (seen.text("position"), seen.text("age")) == (NO_FIGURE, NO_FIGURE)
    seen.picture("lost")

    with service_again(line):
        seen.wait_for_text("headline", "no samples yet")
    seen.wait_for_state("lost")
    assert seen.wrongs() == []


@contextmanager
def service_again(line: Line) -> Iterator[None]:
    """Start the service on the port that it had."""
    command = [Path(sys.executable).parent / "beamtouch-service", "run", "--config", line.folder / "service.toml"]
    with subprocess.Popen([*map(str, command), "--port", str(urlsplit(line.url).port)]) as process:
        try:
            yield
        finally:
            process.terminate()
            process.wait(60)


def test_a_service_that_hangs_is_no_connection(start: Callable[..., Line], open_page: OpenPage) -> None:
    line = start("bench")
    seen, patient = open_page(line.url, is_patient=False), open_page(line.url)
    for one in (seen, patient):
        one.wait_for_state("contact")
        one.watch()
    service = line._processes["service"]
    os.kill(service.pid, signal.SIGSTOP)
    try:
        # The figures go when they are too old, whether or not the connection has been given up.
        for one, state in ((patient, "silent"), (seen, "lost")):
            one.wait_for_state(state)
            assert one.text("position") == NO_FIGURE
    finally:
        os.kill(service.pid, signal.SIGCONT)
    for one in (seen, patient):
        one.wait_for_state("contact")
        assert one.wrongs() == []


def test_pictures(start: Callable[..., Line], open_page: OpenPage) -> None:
    line = start("press-7")
    panel = open_page(line.url, size=(800, 480), color_scheme="light")
    with closing(Truth(line.truth("press-7"))) as truth:
        compare(panel, truth)
    # Only now: four pages that are drawn all the time need much of a core.
    light = open_page(line.url, color_scheme="light")
    dark = open_page(line.url, color_scheme="dark")
    phone = open_page(line.url, size=(390, 844), color_scheme="dark")
    for name, seen in {"light": light, "dark": dark, "panel": panel, "phone": phone}.items():
        seen.wait_for_state("contact")
        seen.picture(name)
        assert seen.overflow() <= 0, name
    # No column of a table is cut off.
    phone.page.wait_for_selector("#events tr")
    for table in ("#channels", ".scroll"):
        measure = "name => { const one = document.querySelector(name); return one.scrollWidth - one.clientWidth; }"
        assert phone.page.evaluate(measure, table) <= 0, table
    # At arm's length: the digits of a contact have more than 5 mm on a panel of 7 inches, and both charts are on it,
    # whatever the page says while loads come and go.
    assert panel.page.wait_for_function(_DIGITS_PX).json_value() >= 48
    states = list[str]()
    while not {"contact", "clear"} <= set(states):
        bottom, said, state = panel.page.evaluate(_LOWEST)
        assert bottom <= 480, said
        states.append(state)
        panel.page.wait_for_timeout(50)
