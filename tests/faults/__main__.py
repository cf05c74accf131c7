"""`make faults`: puts each fault of the list into a copy of the tree, and says which test catches it.

`faults.toml` states for each fault the promise that it breaks, the file, the lines before and after, and the tests that
should see it. A fault counts as caught if one of these tests fails, while all of them pass without it. Returns 1 if a
fault passes unseen.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

sys.path.insert(0, str(Path(__file__).parent.parent))

from fault_list import ROOT, Fault, read_faults

PACKAGES = ("common", "firmware_protocol", "models", "service", "daemon")
TIMEOUT_S = 900
FAILED = 1
"""Exit code of pytest if a test failed. Others mean that the tests could not be run."""


@dataclass(frozen=True)
class Outcome:
    """What the tests said."""

    code: int
    first_failure: str
    output: str


def main() -> int:
    """Try the faults and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", help="only faults whose file or promise has one of these words")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="faults that are tried at once")
    options = parser.parse_args()
    faults = [
        fault
        for fault in read_faults()
        if not options.words or any(word in f"{fault.file} {fault.promise}" for word in options.words)
    ]
    with tempfile.TemporaryDirectory() as folder:
        copies: SimpleQueue[Path] = SimpleQueue()
        for number in range(options.jobs):
            copies.put(copy_tree(Path(folder) / str(number)))
        if not pass_without_faults(faults, copies, options.jobs):
            return 1
        with ThreadPoolExecutor(options.jobs) as pool:
            outcomes = pool.map(lambda fault: try_fault(fault, copies), faults)
            unseen = sum(not show(fault, outcome) for fault, outcome in zip(faults, outcomes, strict=True))
    print(f"{len(faults) - unseen} of {len(faults)} faults are caught")
    return 1 if unseen else 0


def copy_tree(folder: Path) -> Path:
    """Copy the files that git tracks, and those that it would."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    for name in listed.split("\0"):
        if name and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def pass_without_faults(faults: Sequence[Fault], copies: SimpleQueue[Path], jobs: int) -> bool:
    """Return whether all tests of the faults pass in a copy without any."""
    copy = copies.get()
    tests = sorted({test for fault in faults for test in fault.tests})
    outcome = run_tests(copy, tests, "--numprocesses", str(jobs))
    copies.put(copy)
    if outcome.code:
        print(f"without any fault: {outcome.first_failure or outcome.output}")
    return not outcome.code


def try_fault(fault: Fault, copies: SimpleQueue[Path]) -> Outcome:
    """Run the tests of a fault in a copy that has it."""
    copy = copies.get()
    path = copy / fault.file
    text = path.read_text()
    try:
        path.write_text(text.replace(fault.before, fault.after))
        return run_tests(copy, fault.tests, "--exitfirst")
    finally:
        path.write_text(text)
        copies.put(copy)


def run_tests(copy: Path, tests: Sequence[str], *options: str) -> Outcome:
    """Run tests in a copy, with the packages of the copy."""
    packages = os.pathsep.join(str(copy / package) for package in PACKAGES)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, *tests]
    done = subprocess.run(
        command,
        cwd=copy,
        env=os.environ | {"PYTHONPATH": packages, "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    failed = re.search(r"^FAILED (\S+)", done.stdout, re.MULTILINE)
    return Outcome(done.returncode, failed[1] if failed else "", done.stdout[-2000:] + done.stderr[-2000:])


def show(fault: Fault, outcome: Outcome) -> bool:
    """Print what became of a fault; return whether a test caught it."""
    is_caught = outcome.code == FAILED
    unseen = f"cannot be tried: {outcome.output}" if outcome.code else "NOT CAUGHT"
    how = outcome.first_failure if is_caught else unseen
    print(f"{fault.promise}\n    {fault.file}: {how}", flush=True)
    return is_caught


if __name__ == "__main__":
    sys.exit(main())
