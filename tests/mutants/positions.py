"""Where the packages can be mutated, by the operators of cosmic-ray, and a random sample of these positions.

A position is drawn first and one of its mutations then: an operator between two numbers has a dozen, an `if` has one.
"""

import ast
import contextlib
import random
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cosmic_ray.plugins
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from parso.python.tree import Keyword
from parso.tree import BaseNode, NodeOrLeaf

CHECKS = {"zip": {"strict"}, "dataclass": {"frozen", "slots"}}
"""Keywords that, if they are True, only make a mistake of a programmer fail, by the call that has them."""

OPPOSITE = {"Is": "NotEq", "IsNot": "Eq"}
"""What identity becomes. Of None, members of enums and models, equal ones are the same, so that no test can tell `==`
from `is`; and an order of them nobody would write."""

Place = tuple[int, int]
"""Line, from 1, and column, from 0."""


@dataclass(frozen=True)
class Mutant:
    """A file of the tree with one mutation."""

    file: str
    """From the top folder."""
    line: int
    last_line: int
    operator: str
    before: str
    """The lines that change."""
    after: str
    text: str = field(repr=False)
    """The whole file, mutated."""


class CallRemover(Operator):  # type: ignore[misc]
    """Replaces a statement that only calls something, or raises, by `pass`: what is done is what tests forget."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[tuple[Place, Place]]:
        """Yield the statement if `node` is one."""
        statement = node.parent
        if statement is not None and statement.type == "simple_stmt" and statement.children[0] is node and _acts(node):
            yield node.start_pos, node.end_pos

    def mutate(self, node: NodeOrLeaf, index: int) -> NodeOrLeaf:  # noqa: ARG002 - of the base class
        """Return the statement that does nothing."""
        blank = len(node.get_code()) - len(node.get_code(include_prefix=False))
        return Keyword("pass", node.start_pos, prefix=node.get_code()[:blank])

    @classmethod
    def examples(cls) -> tuple[()]:
        """Return none; `tests/common/test_mutants.py` has them."""
        return ()


def _acts(node: NodeOrLeaf) -> bool:
    if node.type == "raise_stmt":
        return True
    called = node
    while isinstance(called, BaseNode) and called.type in {"await_expr", "atom_expr", "power"}:
        called = called.children[-1]
    return isinstance(called, BaseNode) and called.type == "trailer" and called.children[0].get_code() == "("


def operators() -> dict[str, Operator]:
    """Return the operators that need no arguments and make what someone could have written, by name."""
    names = [name for name in sorted(cosmic_ray.plugins.operator_names()) if _is_plausible(name)]
    classes = {name: cosmic_ray.plugins.get_operator(name) for name in names}
    return {name: made() for name, made in classes.items() if not made.arguments()} | {"CallRemover": CallRemover()}


def _is_plausible(name: str) -> bool:
    """Return whether an operator makes no shift or comparison of identity, which any test of types would see."""
    _, _, exchange = name.partition("Operator_")
    old, _, new = exchange.partition("_")
    bits = {"BitAnd", "BitOr"}
    if old in OPPOSITE:
        return new == OPPOSITE[old]
    return new not in {"LShift", "RShift", "BitXor", "Is", "IsNot"} and (new in bits) <= (old in bits)


def positions_in(text: str, operators: dict[str, Operator]) -> dict[tuple[Place, Place], list[tuple[str, int]]]:
    """Return for each position in a file the operators that can change it, each with the number of its occurrence.

    Annotations are passed over: nothing runs them, or importing fails at once. So is what only checks the code itself,
    `strict=True` of `zip`, and `frozen=True` and `slots=True` of a dataclass. `is` only becomes its opposite. The star
    between parameters is no product.
    """
    tree = ast.parse(text)
    spans = [
        ((node.lineno, node.col_offset), (node.end_lineno or 0, node.end_col_offset or 0))
        for node in (*_annotations(tree), *_checks_of_the_code(tree))
    ]
    nodes = list(ast_nodes(get_ast(text)))
    stars = {node.start_pos for node in nodes if node.type == "operator" and node.parent.type == "parameters"}
    found = defaultdict(list)
    for name, operator in operators.items():
        places = (place for node in nodes for place in operator.mutation_positions(node))
        for occurrence, (start, end) in enumerate(places):
            if start not in stars and not any(first <= start < last for first, last in spans):
                found[start, end].append((name, occurrence))
    return dict(found)


def _annotations(tree: ast.AST) -> Iterator[ast.expr]:
    for node in ast.walk(tree):
        for name in ("annotation", "returns"):
            if (of_node := getattr(node, name, None)) is not None:
                yield of_node


def _checks_of_the_code(tree: ast.AST) -> Iterator[ast.expr]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            for keyword in node.keywords:
                if keyword.arg in CHECKS.get(node.func.id, ()) and getattr(keyword.value, "value", None) is True:
                    yield keyword.value


def sample(root: Path, files: Sequence[str], count: int, seed: int) -> tuple[list[Mutant], int]:
    """Return `count` mutants, at positions drawn at random without repetition, and the number of positions."""
    of_all = operators()
    positions = [
        (file, position, choices)
        for file in files
        for position, choices in sorted(positions_in((root / file).read_text(), of_all).items())
    ]
    drawn = random.Random(seed)  # noqa: S311 - of a test
    drawn.shuffle(positions)
    mutants = list[Mutant]()
    for file, (start, end), choices in positions:
        if len(mutants) == count:
            break
        name, occurrence = drawn.choice(choices)
        text = (root / file).read_text()
        # Exceptions of a module are no name that could be replaced.
        with contextlib.suppress(SyntaxError, AttributeError):
            mutated = mutate_code(text, of_all[name], occurrence)
            compile(mutated, file, "exec")
            before, after = _changed(text, mutated)
            mutants.append(Mutant(file, start[0], end[0], name.rpartition("/")[2], before, after, mutated))
    return mutants, len(positions)


def _changed(before: str, after: str) -> tuple[str, str]:
    """Return the lines that differ between two texts, of each."""
    old, new = before.splitlines(), after.splitlines()
    first, last = _equal(old, new), _equal(old[::-1], new[::-1])
    return "\n".join(old[first : len(old) - last]), "\n".join(new[first : len(new) - last])


def _equal(old: Sequence[str], new: Sequence[str]) -> int:
    """Return how many lines at the beginning are the same."""
    pairs = zip(old, new, strict=False)
    return next((number for number, (one, other) in enumerate(pairs) if one != other), min(len(old), len(new)))
