"""The clocks that ages are counted by, in a name space in which the machine has slept."""

import subprocess
import sys

import pytest

from parts import require

SLEPT_S = 100_000


@pytest.mark.parametrize(
    ("module", "clock"),
    [("beamtouch_daemon.uptime", "uptime_s"), ("beamtouch_service.api.context", "boot_clock")],
)
def test_what_is_from_before_a_suspend_is_old(module: str, clock: str) -> None:
    """Daemon and service count the sleep of the machine, which Python's monotonic clock leaves out."""
    command = [require("unshare", "util-linux"), "--user", "--map-root-user", "--time", "--boottime", str(SLEPT_S)]
    if subprocess.run([*command, "true"], capture_output=True, check=False).returncode:
        pytest.skip("name spaces of time are not allowed here")
    code = f"import time, {module} as m; before_s = time.monotonic(); print(m.{clock}() - before_s)"
    done = subprocess.run([*command, sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) >= SLEPT_S - 1
