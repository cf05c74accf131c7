"""`make mutants`: mutates the packages at random places, and says which mutants the tests see.

A sample is drawn with a seed from all positions where cosmic-ray can change the code. For each, the tests that run its
line are tried, those that are quick and narrow first, some two minutes of them; a mutant that only the rest of the
suite would see counts as not caught. Mutants that change nothing anyone could see are listed with the reason in
`equivalent/` and count neither way. Which tests run a line is measured first, if packages or tests have changed.
Returns 130 if it is interrupted; no process of a test outlives it.
"""

import argparse
import asyncio
import contextlib
import hashlib
import os
import re
import signal
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from faults.copies import PACKAGES, ROOT, Outcome, copy_tree
from mutants.covering import Covering, collect
from mutants.equivalents import reason_of
from mutants.forking import Runner
from mutants.positions import Mutant, sample

KEPT = ROOT / "build" / "mutants"
TESTS_S = 120.0
"""How long the tests of a mutant take together without it, as measured with coverage."""
FIRST = 8
"""How many are tried before the others, as most mutants are seen at once."""
TEST_TIMEOUT_S = 120
MUTANT_TIMEOUT_S = 600.0
"""For one test, and for all of a mutant: one that loops is seen."""
SOME_FAILED = 1
"""Exit code of pytest after tests that failed."""
CAUGHT, SURVIVED, NOT_RUN, EQUIVALENT = "caught", "SURVIVED", "NO TEST RUNS IT", "equivalent"


@dataclass(frozen=True)
class Judged:
    """A mutant and what became of it."""

    mutant: Mutant
    verdict: str
    said: str
    seconds: float


def main() -> int:
    """Try a sample of mutants, and print each and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", help="only files whose path has one of these words")
    parser.add_argument("--count", type=int, default=400, help="size of the sample (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2 * (os.cpu_count() or 1), help="mutants that are tried at once")
    parser.add_argument("--tests", nargs="+", default=(), metavar="TEST", help="measure and try only these tests")
    parser.add_argument("--kept", type=Path, default=KEPT, metavar="FOLDER", help="folder of what was measured")
    parser.add_argument("--as-it-was", action="store_true", help="use what was measured although something has changed")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(KeyboardInterrupt):
        copies = [copy_tree(Path(folder) / str(number)) for number in range(max(options.jobs, 1))]
        kept, digest = options.kept, options.kept / "digest"
        if not digest.is_file() or (digest.read_text() != _digest() and not options.as_it_was):
            print("measuring which tests run which lines", flush=True)
            code = collect(copies[0], kept, 2 * len(copies), options.tests)
            if code:
                print(f"without a mutant, tests fail, and are left out: {kept / 'tests.log'}")
            if code > SOME_FAILED:
                return code
            digest.write_text(_digest())
        files = [file for file in _files() if not options.words or any(word in file for word in options.words)]
        mutants, positions = sample(ROOT, files, options.count, options.seed)
        print(f"{len(mutants)} of {positions} positions in {len(files)} files, seed {options.seed}", flush=True)
        judged = asyncio.run(try_all(mutants, copies, Covering(kept)))
        print(table(judged))
        return 0
    return 130


def _files() -> list[str]:
    paths = (path for package in PACKAGES for path in sorted((ROOT / package).rglob("beamtouch_*/**/*.py")))
    return [str(path.relative_to(ROOT)) for path in paths]


def _digest() -> str:
    """Return a digest of packages and tests."""
    digest = hashlib.sha256()
    for folder in (*PACKAGES, "tests"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


async def try_all(mutants: Sequence[Mutant], copies: Sequence[Path], covering: Covering) -> list[Judged]:
    """Try each mutant in whichever copy is free."""
    waiting = list(reversed(mutants))
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(_try_in(copy, waiting, covering)) for copy in copies]
    return [judged for task in tasks for judged in task.result()]


async def _try_in(copy: Path, waiting: list[Mutant], covering: Covering) -> list[Judged]:
    judged, runner = [], Runner(copy)
    try:
        while waiting:
            mutant = waiting.pop()
            judged.append(await _judge(copy, runner, mutant, covering))
            show(judged[-1])
    finally:
        await runner.close()
    return judged


async def _judge(copy: Path, runner: Runner, mutant: Mutant, covering: Covering) -> Judged:
    """Run the tests of a mutant until one fails."""
    path = copy / mutant.file
    text = path.read_text()
    if why := reason_of(mutant, text):
        return Judged(mutant, EQUIVALENT, why, 0.0)
    tests = covering.tests_of(mutant.file, mutant.line, mutant.last_line, TESTS_S)
    path.write_text(mutant.text)
    seconds = 0.0
    try:
        for some in (tests[:FIRST], tests[FIRST:]):
            if some:
                outcome = await _run(runner, some)
                seconds += outcome.seconds
                if outcome.code:
                    return Judged(mutant, CAUGHT, outcome.failure or outcome.output[-300:].strip(), seconds)
    finally:
        path.write_text(text)
    return Judged(mutant, SURVIVED if tests else NOT_RUN, f"{len(tests)} tests", seconds)


async def _run(runner: Runner, tests: Sequence[str]) -> Outcome:
    options = ("--exitfirst", f"--timeout={TEST_TIMEOUT_S}")
    outcome = await runner.run((*options, *tests), MUTANT_TIMEOUT_S)
    if "ERROR: not found: " in outcome.output:
        # The mutant is in a parameter of the test, and so in its name.
        whole = list(dict.fromkeys(re.sub(r"\[.*", "", test) for test in tests))
        outcome = await runner.run((*options, *whole), MUTANT_TIMEOUT_S)
    return outcome


def show(judged: Judged) -> None:
    """Print what became of a mutant."""
    mutant = judged.mutant
    changes = [f"    - {line.strip()}" for line in mutant.before.splitlines()]
    changes += [f"    + {line.strip()}" for line in mutant.after.splitlines()]
    said = f"    {judged.said.splitlines()[0] if judged.said else ''}"
    head = f"{judged.verdict}: {mutant.file}:{mutant.line} {mutant.operator} ({judged.seconds:.0f} s)"
    print("\n".join((head, *changes, said)), flush=True)


def table(judged: Sequence[Judged]) -> str:
    """Return the share of mutants that are caught, for each folder and for all, as Markdown."""
    folders = defaultdict[str, list[Judged]](list)
    for one in judged:
        folders[_folder(one.mutant.file)].append(one)
    rows = [_row(folder, of_folder) for folder, of_folder in sorted(folders.items())]
    head = ("| folder | mutants | equivalent | caught | score |", "| --- | --- | --- | --- | --- |")
    return "\n".join((*head, *rows, _row("all", judged)))


def _folder(file: str) -> str:
    package, _, *inner = Path(file).parts
    return f"{package}/{inner[0]}" if len(inner) > 1 else package


def _row(name: str, judged: Sequence[Judged]) -> str:
    equivalent = sum(one.verdict == EQUIVALENT for one in judged)
    caught, counted = sum(one.verdict == CAUGHT for one in judged), len(judged) - equivalent
    if not counted:
        return f"| {name} | {len(judged)} | {equivalent} | 0 | |"
    share = caught / counted
    # Agresti and Coull: two of each are added, so that few mutants say little.
    middle = (caught + 2) / (counted + 4)
    half = 1.96 * sqrt(middle * (1 - middle) / (counted + 4))
    return f"| {name} | {len(judged)} | {equivalent} | {caught} | {100 * share:.0f} % (+- {100 * half:.0f}) |"


if __name__ == "__main__":
    sys.exit(main())
