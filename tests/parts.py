"""Debian parts that tests need: where one is missing a test is skipped with the reason, in CI it fails."""

import os
import shutil

import pytest


def require(program: str, package: str) -> str:
    """Return the path of a program; without it skip the test, or fail it where CI=true."""
    path = shutil.which(program)
    if path is None:
        message = f"{program} is not installed: apt-get install {package}"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    return path
