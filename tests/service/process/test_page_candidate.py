"""What the page says of a candidate for the model: how it differs, or why it is not compared."""

from pathlib import Path

import pytest

from service.bench import START_US, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.conftest import StartService
from support.pages.browser import OpenPage
from support.surfaces.small_model import content_of, model_of

NEW = model_of("new", force_n_per_mm=12.0).identity


@pytest.mark.promise("docs/how-to/rollout.md", "The page says in a sentence how the two differ")
def test_the_page_says_how_a_candidate_differs_or_why_it_is_not_compared(
    start_press: StartService, open_page: OpenPage, tmp_path: Path
) -> None:
    service = start_press()
    candidate = tmp_path / "press-7.candidate.onnx"
    seen = open_page(service.url, often=["candidate"])
    seen.wait_for_text("model", "press-7@")
    assert seen.text("candidate") == ""
    candidate.write_bytes(content_of("new", force_n_per_mm=12.0))
    seen.wait_for_text(
        "candidate", f"Candidate {NEW} for the model: another state in 0 of 0 samples. These are too few"
    )
    rows = [RESTING] * 160 + [TOUCHING] * 60
    assert service.post(batch_of(*rows, sequence=1, begin_us=START_US)).status_code == 200
    seen.wait_for_text("candidate", "another state in 0 of 220 samples. Contacts differ by 0 mm, 1.8 N. Nothing speaks")
    candidate.write_bytes(b"nothing of the kind")
    seen.wait_for_text("candidate", "The candidate for the model is not compared: ")
    candidate.unlink()
    seen.page.wait_for_function("() => !document.getElementById('candidate').innerText")
