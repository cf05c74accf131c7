"""From a line to a checked configuration, as a technician types it: rig, `scan`, `init`, `check --wait`."""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from example_scenes import SCENES
from forked import Forked
from forked_line import MODULES
from waiting import wait_until

pytestmark = pytest.mark.long

TOKEN = "token-that-writes-of-the-tests"  # noqa: S105 - of tests


@contextmanager
def running(folder: Path, program: str, *words: str | Path) -> Iterator[Forked]:
    """Run a command of ours in a folder until the end of the block."""
    process = Forked(MODULES[program], [str(word) for word in words], folder)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=60)


def daemon(folder: Path, *words: str) -> tuple[int, str, str]:
    """Run a command of the daemon to its end; return its exit code and what it said."""
    process = Forked(MODULES["beamtouch-daemon"], words, folder)
    out, err = process.communicate(timeout=280)
    return process.wait(), out, err


@pytest.mark.parametrize(("option", "kind"), [("--modbus-rtu", "modbus-rtu"), ("--serial", "serial")])
def test_what_scan_finds_becomes_a_configuration_that_passes_check(
    tmp_path: Path, bench_model: Path, option: str, kind: str
) -> None:
    (tmp_path / "bench.daemon.toml").write_text(daemon_config(modelfile.load(bench_model).metadata))
    (tmp_path / "beamtouch.token").write_text(TOKEN)
    rig = (SCENES / "bench.toml", "--model", bench_model, option, "line")
    serve = ("run", "--model", bench_model, "--write-token-file", "beamtouch.token", "--port", "0")
    with running(tmp_path, "beamtouch-rig", *rig), running(tmp_path, "beamtouch-service", *serve) as service:
        url = service.stdout.readline().removeprefix("listening on ").strip()
        wait_until((tmp_path / "line").exists)
        patient = ("--timeout-ms", "30000") if kind == "modbus-rtu" else ()
        code, found, said = daemon(
            tmp_path, "scan", "line", "--units", "1", "--baud", "1000000", "--parity", "none", *patient
        )
        assert code == 0, said
        (line,) = (line for line in found.splitlines() if line.startswith("beamtouch-daemon init "))
        words = shlex.split(line.replace(" FILE ", " bench.daemon.toml "))[1:]
        code, _, said = daemon(tmp_path, *words, "--url", url)
        assert code == 0, said
        code, checked, said = daemon(tmp_path, "check", "daemon.toml", "--wait", "120")
    assert code == 0, said
    assert f'kind = "{kind}"' in (tmp_path / "daemon.toml").read_text()
    assert [row.split()[1] for row in checked.splitlines()[1:5]] == ["s1", "s2", "s3", "s4"]
