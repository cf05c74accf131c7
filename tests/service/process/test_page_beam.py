"""The drawing of the beam in a real browser: supports, the shape by the model, what was measured beside it."""

import re
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper

from beamtouch_models import runtime
from service.process.beam_page import StartBench, bench_shape, circles, drawn
from support.pages.browser import OpenPage, Watched
from support.running.waiting import wait_until

LENGTH_MM = 400.0
PIXEL = 0.6
"""Allowed difference of places in a drawing [px]: the table has 41 places and 33 loads."""


def wait_for_line(seen: Watched, name: str) -> None:
    seen.page.wait_for_selector(f"#beam polyline.{name}", state="attached")


def wait_for_shape(seen: Watched) -> None:
    """Wait until the shape by the model is drawn, from end to end."""
    seen.wait_for_text("beam-words", "by the model")


def bench_factor(seen: Watched) -> float:
    found = re.search(r"deflection, ([\d.]+) times", seen.text("beam-words"))
    assert found
    return float(found[1])


@pytest.mark.promise(
    "docs/reference/page.md",
    "In a contact it bends as the model says for the stated position and force.",
)
def test_a_contact_bends_the_beam_as_physics_does(start_bench: StartBench, open_page: OpenPage) -> None:
    bench = start_bench()
    bench.load((130, 12))
    seen = open_page(bench.service.url)
    wait_for_shape(seen)
    line = drawn(seen, "bent")
    (left, rest), (right, _) = line[0], line[-1]
    px_per_mm = (right - left) / LENGTH_MM
    at_mm = [(x - left) / px_per_mm for x, _ in line]
    true_px = 12 * bench_shape(at_mm, 130.0) * px_per_mm * bench_factor(seen)
    assert true_px.max() > 20
    assert np.array([y - rest for _, y in line]) == pytest.approx(true_px, abs=PIXEL)
    # What was measured lies on it, and the tip of the contact is at its place.
    channels = bench.model.metadata.layout
    assert [x for x, _ in circles(seen)] == pytest.approx(
        [left + one.position_mm * px_per_mm for one in channels], abs=PIXEL
    )
    for x, y in circles(seen):
        assert y == pytest.approx(np.interp(x, *np.transpose(line)), abs=PIXEL)
    # Found and measured in one step: a drawing that has been replaced has no extent.
    boxes = '[...document.querySelectorAll("#beam .support")].map(one => one.getBBox())'
    assert seen.page.evaluate(f"{boxes}.map(({{x, width}}) => x + width / 2)") == pytest.approx(
        [left, right], abs=PIXEL
    )
    # Sensors are as wide as their housings, which take 12 mm of this beam.
    boxes = '[...document.querySelectorAll("#beam rect.sensor")].map(one => one.getBBox().width)'
    assert seen.page.evaluate(boxes) == pytest.approx([12 * px_per_mm] * len(channels), abs=PIXEL)


def test_clear_is_a_straight_beam_and_nothing_known_is_no_beam(start_bench: StartBench, open_page: OpenPage) -> None:
    bench = start_bench()
    seen = open_page(bench.service.url)
    seen.page.wait_for_selector("#beam .support", state="attached")
    assert drawn(seen, "bent") == []
    bench.send([0.002, -0.002, 0.001, 0.0])
    seen.wait_for_state("clear")
    wait_for_line(seen, "bent")
    assert len({y for _, y in drawn(seen, "bent")}) == 1
    assert len({y for _, y in circles(seen)}) > 1


def test_it_is_asked_for_once_and_again_for_another_model(
    start_bench: StartBench, bench_model: Path, tmp_path: Path, open_page: OpenPage
) -> None:
    path = tmp_path / "press-7.onnx"
    shutil.copy(bench_model, path)
    bench = start_bench(model=path)
    bench.load((130, 12))
    seen = open_page(bench.service.url)
    wait_for_shape(seen)
    for force in (11, 10, 9):
        bench.load((130, force))
        seen.wait_for_text("force", str(force))
    asked = [url for url in seen.requests if url.endswith("/beam")]
    assert len(asked) == 1

    first = bench.model.identity
    add_support(path, 200.0)
    wait_until(lambda: bench.service.get("/surfaces/press-7").json()["model"] != first)
    bench.load((130, 12))
    seen.page.wait_for_function("() => document.querySelectorAll('#beam .support').length === 3")
    assert len([url for url in seen.requests if url.endswith("/beam")]) == 2
    assert first not in seen.text("model")
    assert seen.complaints == []


def add_support(path: Path, at_mm: float) -> None:
    """Write a model file again that differs in a support that is drawn."""
    metadata = runtime.load(path).metadata
    more = runtime.BeamDrawing.model_validate(
        metadata.drawn.model_dump()
        | {"supports": [*metadata.drawn.model_dump()["supports"], {"at_mm": at_mm, "kind": "fixed", "slides": False}]}
    )
    graph = onnx.load(path)
    helper.set_model_props(graph, metadata.model_copy(update={"drawn": more}).to_entries())
    path.write_bytes(graph.SerializeToString())


def test_without_an_answer_the_page_goes_on_and_asks_again(start_bench: StartBench, open_page: OpenPage) -> None:
    bench = start_bench()
    bench.load((130, 12))
    seen = open_page(bench.service.url)
    wait_for_shape(seen)
    seen.page.route("**/beam", lambda route: route.fulfill(status=500, body="no"))
    seen.page.reload()
    seen.wait_for_state("contact")
    seen.wait_for_text("beam-words", "a smooth curve through them")
    wait_for_line(seen, "guessed")
    assert float(seen.text("position")) == pytest.approx(130, abs=1)
    assert seen.page.query_selector("#beam .support") is None
    # The browser itself notes an answer of 500.
    assert [one for one in seen.complaints if "500" not in one] == []
    seen.page.unroute("**/beam")
    wait_for_shape(seen)
