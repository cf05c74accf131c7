"""From a line to a checked configuration, as a technician types it: rig, `scan`, `init`, `check --wait`."""

import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from example_scenes import SCENES
from waiting import wait_until

pytestmark = pytest.mark.long

TOKEN = "token-that-writes-of-the-tests"  # noqa: S105 - of tests


@contextmanager
def running(folder: Path, module: str, *words: str | Path) -> Iterator[subprocess.Popen[str]]:
    """Run a command of ours in a folder until the end of the block."""
    program = [sys.executable, "-m", module, *map(str, words)]
    with subprocess.Popen(program, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()


def daemon(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-m", "beamtouch_daemon", *words]
    return subprocess.run(program, cwd=folder, capture_output=True, text=True, check=False, timeout=280)


@pytest.mark.parametrize(("option", "kind"), [("--modbus-rtu", "modbus-rtu"), ("--serial", "serial")])
def test_what_scan_finds_becomes_a_configuration_that_passes_check(
    tmp_path: Path, bench_model: Path, option: str, kind: str
) -> None:
    (tmp_path / "bench.daemon.toml").write_text(daemon_config(modelfile.load(bench_model).metadata))
    (tmp_path / "beamtouch.token").write_text(TOKEN)
    with ExitStack() as stack:
        rig = ("beamtouch_models.rig.cli", SCENES / "bench.toml", "--model", bench_model, option, "line")
        stack.enter_context(running(tmp_path, *map(str, rig)))
        serve = ("run", "--model", bench_model, "--write-token-file", "beamtouch.token", "--port", "0")
        service = stack.enter_context(running(tmp_path, "beamtouch_service.cli", *serve))
        assert service.stdout is not None
        url = service.stdout.readline().removeprefix("listening on ").strip()
        wait_until((tmp_path / "line").exists)
        patient = ("--timeout-ms", "30000") if kind == "modbus-rtu" else ()
        found = daemon(tmp_path, "scan", "line", "--units", "1", "--baud", "1000000", "--parity", "none", *patient)
        assert found.returncode == 0, found.stderr
        (line,) = (line for line in found.stdout.splitlines() if line.startswith("beamtouch-daemon init "))
        words = shlex.split(line.replace(" FILE ", " bench.daemon.toml "))[1:]
        made = daemon(tmp_path, *words, "--url", url)
        checked = daemon(tmp_path, "check", "daemon.toml", "--wait", "120")
    assert made.returncode == 0, made.stderr
    assert f'kind = "{kind}"' in (tmp_path / "daemon.toml").read_text()
    assert checked.returncode == 0, checked.stderr
    assert [row.split()[1] for row in checked.stdout.splitlines()[1:5]] == ["s1", "s2", "s3", "s4"]
