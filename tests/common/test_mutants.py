"""`make mutants` changes what someone could have written, and tries the tests that run it."""

import asyncio
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from coverage import CoverageData

from faults.copies import ROOT
from mutants.covering import Covering
from mutants.equivalents import constants, listed, reason_of, tuned
from mutants.forking import LONGEST_OUTPUT, Runner
from mutants.positions import CallRemover, Mutant, operators, positions_in, sample

CODE = '''"""Doubles."""
HALF: int | None = 2

def double(value: float | None) -> float:
    """Return twice a value."""
    if value is None:
        raise ValueError
    print(value)
    return value * HALF


def read() -> None:
    try:
        print()
    except (json.JSONDecodeError, OSError):
        pass
'''
FILE = "common/beamtouch_common/doubles.py"


def test_positions_are_where_code_runs() -> None:
    lines = {start[0] for start, _ in positions_in(CODE, operators())}
    assert lines == {2, 6, 7, 8, 9, 14, 15}
    starts = {start for start, _ in positions_in(CODE, operators())}
    assert (2, 9) not in starts  # of the annotation `int | None`


def test_what_only_checks_the_code_is_passed_over() -> None:
    names = {"True": ("core/ReplaceTrueWithFalse",), "False": ("core/ReplaceFalseWithTrue",)}
    replacing = {name: one for name, one in operators().items() if name in [*names["True"], *names["False"]]}
    assert len(replacing) == 2
    code = (
        "@dataclass(frozen=True, slots=True, eq=False)\n"
        "class Pair:\n    one: int\n\n"
        "pairs = zip(a, b, strict=True)\n"
        "others = zip(a, b, strict=False)\n"
        "field = Field(strict=True, frozen=True)\n"
    )
    found = [start for start, _ in sorted(positions_in(code, replacing))]
    assert found == [(1, 39), (6, 26), (7, 21), (7, 34)]


def test_the_star_between_parameters_is_no_product() -> None:
    found = positions_in("def area(a, *, b):\n    return a * b\n", operators())
    assert {start[0] for start, _ in found} == {2}


def test_identity_only_becomes_its_opposite() -> None:
    for operator, opposite in (("is", "Is_NotEq"), ("is not", "IsNot_Eq")):
        (choices,) = positions_in(f"found = value {operator} State.CLEAR\n", operators()).values()
        assert choices == [(f"core/ReplaceComparisonOperator_{opposite}", 0)]


def test_statements_that_only_call_or_raise_are_removed() -> None:
    assert set(positions_in(CODE, {"CallRemover": CallRemover()})) == {
        ((7, 8), (7, 24)),
        ((8, 4), (8, 16)),
        ((14, 8), (14, 15)),
    }


def test_a_sample_is_the_same_for_a_seed_and_is_code(tmp_path: Path) -> None:
    (tmp_path / FILE).parent.mkdir(parents=True)
    (tmp_path / FILE).write_text(CODE)
    mutants, positions = sample(tmp_path, [FILE], 100, 1)
    again, _ = sample(tmp_path, [FILE], 100, 1)
    assert mutants == again
    assert len(mutants) <= positions
    assert all(mutant.text != CODE and compile(mutant.text, FILE, "exec") for mutant in mutants)
    removed = next(mutant for mutant in mutants if mutant.line == 8)
    assert (removed.before.strip(), removed.after.strip()) == ("print(value)", "pass")


def test_quick_tests_of_a_line_come_first_and_all_tests_of_the_file_for_a_constant(tmp_path: Path) -> None:
    data = CoverageData(str(tmp_path / ".coverage"))
    ran = {"quick|run": [6, 9], "slow (call)": [6, 9], "other|setup": [6, 7], "unknown|run": [6], "fails|run": [6, 9]}
    for context, lines in ran.items():
        data.set_context(f"tests/test_doubles.py::{context}")
        data.add_lines({f"/copy/{FILE}": lines})
    data.set_context("")
    data.add_lines({f"/copy/{FILE}": [2, 4]})
    data.set_context("tests/test_doubles.py::other|run")  # the first one that imported it
    data.add_lines({f"/copy/{FILE}": [2, 4]})
    data.write()
    (tmp_path / FILE).parent.mkdir(parents=True)
    (tmp_path / FILE).write_text(CODE)
    cases = "".join(
        f'<testcase classname="tests.test_doubles" name="{name}" time="{seconds}"/>'
        for name, seconds in (("quick", 0.1), ("slow", 5), ("other", 0.2))
    )
    cases += '<testcase classname="tests.test_halves" name="reads" time="0.3"/>'
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_halves.py").write_text("from beamtouch_common.doubles import HALF\n")
    fails = '<testcase classname="tests.test_doubles" name="fails" time="0.1"><failure/></testcase>'
    (tmp_path / "times.xml").write_text(f"<testsuite>{cases}{fails}</testsuite>")
    covering = Covering(tmp_path, tmp_path)

    def names(first: int, last: int, at_most_s: float = 60.0) -> list[str]:
        return [test.rpartition("::")[2] for test in covering.tests_of(FILE, first, last, at_most_s)]

    assert names(9, 9) == ["quick", "slow"]
    assert names(7, 7) == ["other"]
    assert names(2, 2) == ["reads", "quick", "slow", "other"]
    assert names(9, 9, at_most_s=1.0) == ["quick"]
    assert covering.tests_of("common/beamtouch_common/unknown.py", 1, 1, 60.0) == []


@pytest.mark.soak
def test_mutants_are_caught_by_tests_that_run_them_and_counted_by_folder(tmp_path: Path) -> None:
    words = ["common/beamtouch_common/digits.py", "--count", "4", "--jobs", "1", "--kept", str(tmp_path)]
    tests = ["--tests", "tests/common/test_text.py", "tests/common/test_words.py"]
    command = [sys.executable, "tests/mutants", *words, *tests]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "in 1 files, seed 0" in done.stdout
    caught = done.stdout.count("\ncaught: common/beamtouch_common/digits.py:")
    assert caught >= 1, done.stdout
    assert f"| common | 4 | 0 | {caught} | {25 * caught} % " in done.stdout


TESTS = """
import os
import time
from signal import SIGKILL

import doubles


def test_two() -> None:
    assert doubles.HALF == 2


def test_endless(capfd) -> None:
    with capfd.disabled():
        for _ in range(40):
            os.write(1, b"\\xff" * 2**20)
    assert doubles.HALF == 3


def test_stuck() -> None:
    time.sleep(900)


def test_fatal() -> None:
    os.kill(os.getppid(), SIGKILL)
    time.sleep(900)
"""


@pytest.mark.soak
def test_forked_tests_see_the_code_as_it_is_then_and_whatever_they_do_the_next_ones_run(tmp_path: Path) -> None:
    (tmp_path / "test_doubles.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")

    async def run() -> None:
        runner = Runner(tmp_path)

        async def code_of(test: str, half: int = 2, timeout_s: float = 300.0) -> int:
            (tmp_path / "doubles.py").write_text(f"HALF = {half}\n")
            outcome = await runner.run([f"test_doubles.py::{test}"], timeout_s)
            assert len(outcome.output) <= LONGEST_OUTPUT
            assert (f"FAILED test_doubles.py::{test} " in outcome.output) is (outcome.code == 1), outcome.output
            return outcome.code

        try:
            assert await code_of("test_two") == 0
            assert await code_of("test_two", half=30) == 1
            assert await code_of("test_endless") == 1
            assert await code_of("test_stuck", timeout_s=5.0) == -signal.SIGKILL
            assert await code_of("test_fatal") == -signal.SIGKILL
            assert await code_of("test_two") == 0
        finally:
            await runner.close()

    asyncio.run(run())


def test_the_list_of_equivalent_mutants_fits_the_tree() -> None:
    entries = listed("equivalent")
    gone = [one for one in entries if (ROOT / one["file"]).read_text().count(one["before"]) != 1]
    assert gone == []
    assert all(one["before"] != one["after"] and one["why"] for one in entries)


def test_the_list_of_tuned_constants_fits_the_tree() -> None:
    names = {file: constants((ROOT / file).read_text()) for file in {file for file, _ in tuned()}}
    assert [(file, name) for (file, name) in tuned() if name not in names[file]] == []
    assert all(tuned().values())
    assert len(tuned()) == sum(len(one["constants"]) for one in listed("tuned"))


@pytest.mark.parametrize(
    ("before", "after", "is_alike"),
    [
        ("a.reshape(-1, n)", "a.reshape(~1, n)", True),
        ("a.reshape(len(kinds[0]), -1)", "a.reshape(len(kinds[0]), - 2)", True),
        ("a.reshape(-1, n)", "a.reshape( 0, n)", False),
        ("a.reshape(-1, n)", "a.reshape(not 1, n)", False),
        ("f(-1).reshape(n)", "f(- 2).reshape(n)", False),
        ("@lru_cache(maxsize=4)", "@lru_cache(maxsize= 3)", True),
        ("if extent.axes == 1:", "if extent.axes <= 1:", True),
        ("if len(self.axes) > 1:", "if len(self.axes) != 1:", True),
        ("if extent.axes == 1:", "if extent.axes >= 1:", False),
        ("if axes == 1:", "if axes != 1:", False),
    ],
)
def test_what_is_so_wherever_it_stands_is_a_rule(before: str, after: str, is_alike: bool) -> None:
    mutant = Mutant("a.py", 1, 1, "ReplaceComparisonOperator_Eq_LtE", before, after, after)
    assert (reason_of(mutant, before) is not None) is is_alike


TUNED = """DRAWS, FEWEST = 512, 3
SMALL = 2.0**-30
BYTES = 64 << 10
SIZES = {1: (20, 1.0)}
OTHER = 512

@dataclass
class Pace:
    window: int = 40
"""


def test_a_number_of_a_tuned_constant_may_change_by_a_twentieth_of_its_value(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("DRAWS", "FEWEST", "SMALL", "BYTES", "SIZES", "window")
    monkeypatch.setattr("mutants.equivalents.tuned", lambda: {("a.py", name): f"why {name}" for name in names})

    def why(old: str, new: str, operator: str = "NumberReplacer") -> str | None:
        text = TUNED.replace(old, new)
        assert text != TUNED
        return reason_of(Mutant("a.py", 1, 1, operator, old, new, text), TUNED)

    assert why("DRAWS, FEWEST = 512", "DRAWS, FEWEST = 513") == "why DRAWS"
    assert why("64 <<", "63 <<") == "why BYTES"
    assert why("(20", "(21") == why("(20", "(19") == "why SIZES"
    assert why("window: int = 40", "window: int = 41") == "why window"
    for old, new in (("3", "2"), ("-30", "-29"), ("<< 10", "<< 9"), ("1:", "2:"), ("1.0", "2.0"), ("(20", "(22")):
        assert why(old, new) is None, (old, new)
    assert why("OTHER = 512", "OTHER = 513") is None
    assert why("64 <<", "63 <<", "SomeOtherOperator") is None
