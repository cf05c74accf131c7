"""The reference pages in the checkout are what the code says: a gateway without network has nothing else."""

import subprocess
import sys
from pathlib import Path

from pasted import ROOT

PAGES = sorted((ROOT / "docs" / "reference").glob("*.md"))


def test_the_reference_is_what_the_code_says() -> None:
    command: list[str | Path] = [sys.executable, ROOT / "docs" / "generator" / "reference.py", "--check"]

    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)

    assert done.returncode == 0, done.stderr


def test_no_reference_page_sends_its_reader_to_the_site() -> None:
    assert len(PAGES) > 10
    assert [page.name for page in PAGES if "make docs" in page.read_text()] == []
