"""Waiting for what another process does."""

import subprocess
import time
from collections.abc import Callable, Sequence
from signal import SIGINT


def wait_until(condition: Callable[[], bool], within_s: float = 60, pause_s: float = 0.01) -> None:
    """Poll until a condition holds."""
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, f"it did not come true within {within_s:g} s"
        time.sleep(pause_s)


def interrupted(command: Sequence[str], is_at_work: Callable[[int], bool]) -> tuple[int, str, str]:
    """Start a command, press Ctrl-C once it is at work; return its exit code and output.

    `is_at_work` takes the number of the process.
    """
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            wait_until(lambda: process.poll() is not None or is_at_work(process.pid))
            assert process.poll() is None
            process.send_signal(SIGINT)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    return process.returncode, out, err
