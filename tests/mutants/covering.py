"""Which tests run a line, in whatever process, and how long they take.

All tests run once with coverage, whose contexts name the test: in its own process and in those that it starts or forks.
What a test reaches through a process that an earlier test started counts for the earlier one.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Sequence, Set
from itertools import chain, zip_longest
from pathlib import Path

from coverage import CoverageData

from faults.copies import ROOT, environment_of

PHASE = re.compile(r"(\|(setup|run|teardown)| \((setup|call|teardown)\))$")
"""What pytest-cov and pytest write behind the name of a test."""


def collect(copy: Path, kept: Path, workers: int, tests: Sequence[str] = ()) -> int:
    """Run all tests in a copy, or some; write to a folder what each of them ran, and its time. Return pytest's code."""
    command = [
        *(sys.executable, "-m", "pytest", "-q", "-m", "not soak", "-p", "no:cacheprovider", "-n", str(workers)),
        *("--cov", f"--cov-config={copy / 'tests/mutants/coverage.ini'}", "--cov-context=test", "--cov-report="),
        *("--junitxml=times.xml", "-p", "measured", *tests),
    ]
    environment = environment_of(copy)
    environment["PYTHONPATH"] += os.pathsep + str(copy / "tests" / "mutants")
    environment["MUTANTS_DATA"] = str(copy / ".coverage")
    kept.mkdir(parents=True, exist_ok=True)
    with (kept / "tests.log").open("w") as log:
        done = subprocess.run(command, cwd=copy, env=environment, check=False, stdout=log, stderr=log)
    for name in (".coverage", "times.xml"):
        shutil.copy(copy / name, kept / name)
    return done.returncode


class Covering:
    """The tests that ran the lines of the packages."""

    def __init__(self, kept: Path, root: Path = ROOT) -> None:
        """Read what `collect` wrote to a folder; `root` is the top folder of the packages."""
        self._root = root
        self._data = CoverageData(str(kept / ".coverage"))
        self._data.read()
        self._paths = {_from_top(Path(path)): path for path in self._data.measured_files()}
        self._seconds = dict[str, float]()
        for case in ET.parse(kept / "times.xml").iter("testcase"):  # noqa: S314 - our own
            if case.find("failure") is not None or case.find("error") is not None:
                continue  # it would fail with any mutant
            name = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"
            self._seconds[name] = self._seconds.get(name, 0.0) + float(case.get("time", 0.0))
        self._by_line = dict[str, dict[int, frozenset[str]]]()

    def lines_of(self, file: str) -> dict[int, frozenset[str]]:
        """Return the tests that ran each line of a file, of those that passed through it after its import."""
        if file not in self._by_line:
            contexts = self._data.contexts_by_lineno(self._paths[file]) if file in self._paths else {}
            self._by_line[file] = {
                line: frozenset(test for name in names if (test := PHASE.sub("", name)) in self._seconds)
                for line, names in contexts.items()
            }
        return self._by_line[file]

    def tests_of(self, file: str, first: int, last: int, at_most_s: float) -> list[str]:
        """Return the tests of lines of a file, what is quick and narrow first, as many as take `at_most_s` together.

        Lines that run at import, such as constants, have all tests of the file. Those in files that import from it come
        first, as who reads a constant runs no line of its file, and those that run a line with the constant's name.
        """
        lines = self.lines_of(file)
        # A test that is the first to import a file runs its constants; they matter to all tests that use it.
        called = _lines_of_calls((self._root / file).read_text()) if lines else set()
        found = set(chain.from_iterable(lines.get(line, ()) for line in range(first, last + 1) if line in called))
        readers, users = list[str](), set[str]()
        if not found:
            found = set(chain.from_iterable(lines.values()))
            users = self._naming(file, first, last) if lines else set()
            readers = sorted(self._importing(file), key=lambda test: (self._seconds[test], test))
        ran = defaultdict[str, int](int)
        for tests in lines.values():
            for test in tests:
                ran[test] += 1

        def ranked(tests: Set[str]) -> list[str]:
            # A test that runs much of this file is one of its own.
            return sorted(tests, key=lambda test: ((self._seconds[test] + 0.1) / (1 + ran[test]) ** 0.5, test))

        chosen, seconds = dict[str, None](), 0.0
        # Readers of a constant have a third of the time at most, and those that run lines with its name another one.
        for test, limit_s in chain(
            ((one, at_most_s / 3) for one in readers),
            ((one, at_most_s * 2 / 3) for one in _alternating(ranked(users))),
            ((one, at_most_s) for one in _alternating(ranked(found))),
        ):
            if test not in chosen and (seconds + self._seconds[test] <= limit_s or not chosen):
                chosen[test] = None
                seconds += self._seconds[test]
        return list(chosen)

    def _naming(self, file: str, first: int, last: int) -> set[str]:
        """Return the tests that run a line with the name of a constant of these lines, here or where it is imported."""
        names = _assigned_at((self._root / file).read_text(), first, last)
        imports = _imports_of(file)
        tests = set[str]()
        for other in self._paths:
            text = path.read_text() if (path := self._root / other).is_file() else ""
            if other == file or imports.search(text):
                named = {
                    node.lineno
                    for node in ast.walk(ast.parse(text))
                    if (isinstance(node, ast.Name) and node.id in names)
                    or (isinstance(node, ast.Attribute) and node.attr in names)
                }
                lines = self.lines_of(other)
                tests.update(*(lines.get(line, ()) for line in named & _lines_of_calls(text)))
        return tests

    def _importing(self, file: str) -> set[str]:
        """Return the tests in files that import a file of the packages, or something from it."""
        imports = _imports_of(file)
        files = {test.partition("::")[0] for test in self._seconds}
        readers = {
            one for one in files if (self._root / one).is_file() and imports.search((self._root / one).read_text())
        }
        return {test for test in self._seconds if test.partition("::")[0] in readers}


def _imports_of(file: str) -> re.Pattern[str]:
    """Return what matches an import of a file of the packages, or of something from it."""
    _, *module = Path(file.removesuffix("/__init__.py").removesuffix(".py")).parts
    whole, above = (re.escape(".".join(parts)) for parts in (module, module[:-1]))
    return re.compile(
        rf"^ *(from {whole} import|import {whole}\b|from {above} import .*\b{module[-1]}\b)", re.MULTILINE
    )


def _assigned_at(text: str, first: int, last: int) -> set[str]:
    """Return the names that these lines of a file assign at import."""
    return {
        target.id
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.lineno <= last and (node.end_lineno or 0) >= first
        for target in ast.walk(node)
        if isinstance(target, ast.Name) and isinstance(target.ctx, ast.Store)
    }


def _lines_of_calls(text: str) -> set[int]:
    """Return the lines of a file that run when something is called, and not at import."""
    return {
        line
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        for line in range(node.body[0].lineno, (node.end_lineno or 0) + 1)
    }


def _alternating(ranked: list[str]) -> list[str]:
    """Return tests by rank, and between them the best one of each other file, so that no door is left out."""
    of_files = list({test.partition("::")[0]: test for test in reversed(ranked)}.values())[::-1]
    pairs = zip_longest(ranked, of_files)
    return list(dict.fromkeys(test for pair in pairs for test in pair if test is not None))


def _from_top(path: Path) -> str:
    parts = path.parts
    start = max((at for at, part in enumerate(parts[1:]) if part.startswith("beamtouch_")), default=0)
    return str(Path(*parts[start:]))
