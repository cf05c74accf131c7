"""A plugin of pytest: the Python processes that tests start are measured as `coverage.ini` says."""

import os
from pathlib import Path

import pytest


@pytest.hookimpl
def pytest_configure() -> None:
    """Let the processes that come know where to look."""
    os.environ["COVERAGE_PROCESS_START"] = str(Path(__file__).parent / "coverage.ini")
