"""The clock that ages are counted by, in a name space in which the machine has slept."""

import subprocess
import sys

import pytest

from support.running.debian_parts import require

SLEPT_S = 100_000


def test_what_is_from_before_a_suspend_is_old() -> None:
    """Daemon and service count the sleep of the machine, which Python's monotonic clock leaves out."""
    command = [require("unshare", "util-linux"), "--user", "--map-root-user", "--time", "--boottime", str(SLEPT_S)]
    if subprocess.run([*command, "true"], capture_output=True, check=False).returncode:
        pytest.skip("name spaces of time are not allowed here")
    code = "import time, beamtouch_common.uptime as m; before_s = time.monotonic(); print(m.uptime_s() - before_s)"
    done = subprocess.run([*command, sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) >= SLEPT_S - 1
