"""The list of faults that tests must catch fits the tree, and `make faults` says which of them are caught."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from faults.fault_list import ROOT, read_faults
from support.running.waiting import wait_until

FAULTS = """
[[fault]]
promise = "A number has no exponent"
file = "common/beamtouch_common/digits.py"
before = 'if "e" not in text'
after = 'if text'
tests = ["tests/common/test_text.py::test_numbers_of_ordinary_size_have_no_exponent"]

[[fault]]
promise = "No process is left"
file = "tests/common/test_text.py"
before = "import pytest"
after = '''
import subprocess

import pytest

LEFT = subprocess.Popen(["sleep", "900"], process_group=0)
'''
tests = ["tests/common/test_text.py::test_numbers_of_ordinary_size_have_no_exponent"]
"""
"""The first one is caught; the second one is not, and its test leaves a process."""


def test_the_list_of_faults_fits_the_tree() -> None:
    faults = read_faults()
    assert len({fault.promise for fault in faults}) == len(faults)
    assert len({(fault.file, fault.before, fault.after) for fault in faults}) == len(faults)
    tests = {test.partition("::")[0] for fault in faults for test in fault.tests}
    assert [test for test in sorted(tests) if not (ROOT / test).is_file()] == []
    assert [fault for fault in faults if fault.before == fault.after] == []


@pytest.mark.soak
def test_a_fault_that_no_test_sees_fails_the_run_which_leaves_no_process(tmp_path: Path) -> None:
    (tmp_path / "faults.toml").write_text(FAULTS)
    command = [sys.executable, "tests/faults", "--jobs", "1", "--list", str(tmp_path / "faults.toml")]
    mark = str(tmp_path)
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"FAULTS_MARK": mark}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stdout + done.stderr
    test = "tests/common/test_text.py::test_numbers_of_ordinary_size_have_no_exponent["
    assert f"common/beamtouch_common/digits.py: {test}" in done.stdout
    assert "tests/common/test_text.py: NOT CAUGHT" in done.stdout
    assert "1 of 2 faults are caught" in done.stdout
    wait_until(lambda: not any(mark.encode() in _environment(folder) for folder in Path("/proc").glob("[0-9]*")))


def _environment(process: Path) -> bytes:
    try:
        return (process / "environ").read_bytes()
    except OSError:
        return b""  # it has ended meanwhile, or is another user's
