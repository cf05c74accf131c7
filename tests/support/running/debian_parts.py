"""Debian parts that tests need: where one is missing a test is skipped with the reason, in CI it fails."""

import os
import shutil
from typing import NoReturn

import pytest


def require(program: str, package: str) -> str:
    """Return the path of a program; without it skip the test, or fail it where CI=true."""
    path = shutil.which(program)
    if path is None:
        give_up(f"{program} is not installed: apt-get install {package}")
    return path


def give_up(reason: str) -> NoReturn:
    """Skip the test, or fail it where changes are decided (CI=true)."""
    if os.environ.get("CI") == "true":
        pytest.fail(reason, pytrace=False)
    pytest.skip(reason)
