"""The steps of the README from a scene to a contact, typed as they stand there."""

import json
from pathlib import Path

import httpx2
import pytest

from plain_http import TIMEOUT_S
from typed_readme import ROOT, Shell, blocks, shell

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]


def test_the_steps_of_the_readme_end_in_a_contact(tmp_path: Path) -> None:
    start, read, ask, sample, stop = blocks("By hand, step by step")
    with shell(tmp_path) as typed:
        typed.type(start)
        typed.wait_until(lambda: typed.printed.count("listening on") == 2)
        assert "s4" in typed.type(read)
        typed.wait_until(lambda: "bench: reading" in typed.printed)
        typed.wait_until(lambda: answers(typed))
        lines = typed.type(ask).splitlines()
        (answer,) = (json.loads(line) for line in lines if line.startswith("{"))
        typed.type(stop)
        typed.leave()
    assert list(answer) == list(json.loads(sample))
    assert sample in (ROOT / "service" / "README.md").read_text()
    assert answer["readings"] >= 1
    assert answer["surface"] == "bench"


def answers(typed: Shell) -> bool:
    """Return whether the first samples have arrived."""
    return httpx2.get(f"{typed.url}/contact", timeout=TIMEOUT_S).is_success
