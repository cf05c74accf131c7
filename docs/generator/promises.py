"""The promises of the pages with the tests that hold them, from the marks of the tests.

`@pytest.mark.promise(page, sentence, ...)` above a test quotes sentences, or the parts of them that it holds. The table
is made from these marks, so it names no test that is gone, and a sentence that changes fails until somebody has looked
at its tests.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from project import ROOT

TESTS = ROOT / "tests"
MARK = "pytest.mark.promise"
_LINK = re.compile(r"\[([^][]*)\]\([^()]*\)")


@dataclass(frozen=True)
class Promise:
    """A sentence of a page, and a test that fails without what it says."""

    page: str
    sentence: str
    test: str


@cache
def promises() -> tuple[Promise, ...]:
    """Return what the marks of all tests say."""
    return tuple(promise for path in sorted(TESTS.rglob("test_*.py")) for promise in _of_file(path))


def _of_file(path: Path) -> Iterator[Promise]:
    text = path.read_text(encoding="utf-8")
    for node in ast.parse(text).body if MARK in text else []:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for page, *sentences in _marks(node):
                for sentence in sentences:
                    yield Promise(page, sentence, f"{path.relative_to(TESTS)}::{node.name}")


def _marks(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[list[str]]:
    for mark in function.decorator_list:
        if isinstance(mark, ast.Call) and ast.unparse(mark.func) == MARK:
            yield [ast.literal_eval(argument) for argument in mark.args]


@cache
def plain(page: str) -> str:
    """Return the text of a page on one line, without links and bold type, as promises quote it."""
    return " ".join(_LINK.sub(r"\1", (ROOT / page).read_text(encoding="utf-8")).replace("**", "").split())


def as_markdown() -> str:
    """Return a table for each page, with its promises in their order there."""
    tests: defaultdict[str, defaultdict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for promise in promises():
        tests[promise.page][promise.sentence].append(promise.test)
    return "\n\n".join(
        f"## {page.removeprefix('docs/')}\n\n| promise | test |\n| --- | --- |\n"
        + "\n".join(
            f"| {sentence.replace('|', chr(92) + '|')} | {'<br>'.join(f'`{test}`' for test in tests[page][sentence])} |"
            for sentence in sorted(tests[page], key=plain(page).find)
        )
        for page in sorted(tests)
    )
