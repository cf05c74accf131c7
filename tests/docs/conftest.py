"""The site, built once per run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pasted import ROOT
from toolchain import made_once


def _build(folder: Path) -> None:
    """Build the site; a warning is an error."""
    command: list[str | Path] = [
        Path(sys.prefix) / "bin" / "mkdocs",
        "build",
        "--quiet",
        "--strict",
        "--site-dir",
        folder / "site",
    ]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=250, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert not done.stderr, done.stderr


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the built site."""
    return made_once(tmp_path_factory, "site", _build) / "site"
