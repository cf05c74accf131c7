"""`make faults`: puts each fault of the list into a copy of the tree, and says which test catches it.

`faults.toml` states for each fault the promise that it breaks, the file, the lines before and after, and the tests that
should see it. A fault counts as caught if one of these tests fails, while all of them pass without it. A line names
the test and its error, so that a reader sees that the fault was caught for its own reason. Returns 1 if a fault passes
unseen, 130 if it is interrupted; no process of a test outlives it.
"""

import argparse
import asyncio
import contextlib
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from faults.copies import FAILED, Outcome, copy_tree, run_tests
from faults.fault_list import LIST, Fault, read_faults


def main() -> int:
    """Try the faults and print what became of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", help="only faults whose file or promise has one of these words")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="faults that are tried at once")
    parser.add_argument("--list", type=Path, default=LIST, metavar="FILE", help="another list of faults")
    options = parser.parse_args()
    try:
        faults = [
            fault
            for fault in read_faults(options.list)
            if not options.words or any(word in f"{fault.file} {fault.promise}" for word in options.words)
        ]
    except ValueError as error:
        parser.error(str(error))
    if not faults:
        parser.error("no file and no promise of the list has one of these words")
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(KeyboardInterrupt):
        copies = [copy_tree(Path(folder) / str(number)) for number in range(max(options.jobs, 1))]
        return asyncio.run(try_all(faults, copies))
    return 130


async def try_all(faults: Sequence[Fault], copies: Sequence[Path]) -> int:
    """Run the tests without any fault, then each fault in whichever copy is free."""
    tests = sorted({test for fault in faults for test in fault.tests})
    outcome = await run_tests(copies[0], tests, "--numprocesses", str(len(copies)))
    if outcome.code:
        print(f"without any fault: {outcome.failure or outcome.output}")
        return 1
    print(f"without any fault, all tests pass ({outcome.seconds:.0f} s)", flush=True)
    waiting = list(reversed(faults))
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(try_in(copy, waiting)) for copy in copies]
    caught = sum(task.result() for task in tasks)
    print(f"{caught} of {len(faults)} faults are caught")
    return 0 if caught == len(faults) else 1


async def try_in(copy: Path, waiting: list[Fault]) -> int:
    """Try the faults that wait, one after another, in a copy; return how many are caught."""
    caught = 0
    while waiting:
        fault = waiting.pop()
        path = copy / fault.file
        text = path.read_text()
        path.write_text(text.replace(fault.before, fault.after))
        outcome = await run_tests(copy, fault.tests, "--exitfirst")
        path.write_text(text)
        caught += show(fault, outcome)
    return caught


def show(fault: Fault, outcome: Outcome) -> bool:
    """Print what became of a fault; return whether a test caught it."""
    is_caught = outcome.code == FAILED
    unseen = f"cannot be tried: {outcome.output[-2000:]}" if outcome.code else "NOT CAUGHT"
    said = outcome.failure if is_caught else unseen
    print(f"{fault.promise} ({outcome.seconds:.0f} s)\n    {fault.file}: {said}", flush=True)
    return is_caught


if __name__ == "__main__":
    sys.exit(main())
