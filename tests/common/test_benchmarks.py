"""`make bench` without names runs every benchmark, so each must be one."""

import ast
from pathlib import Path

import pytest

BENCHMARKS = sorted((Path(__file__).parents[1] / "benchmarks").glob("bench_*.py"))


@pytest.mark.parametrize("path", BENCHMARKS, ids=lambda path: path.stem)
def test_each_benchmark_has_what_make_bench_calls(path: Path) -> None:
    (run,) = (
        node.args
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef) and node.name == "run"
    )
    required = len(run.posonlyargs) + len(run.args) - len(run.defaults) + run.kw_defaults.count(None)
    assert required == 0  # it is called without arguments
