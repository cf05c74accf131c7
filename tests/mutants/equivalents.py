"""Mutants that no user could tell from the code, judged by hand: `equivalent/` has a list for each part.

Of an `equivalent` entry, `before` and `after` are the lines of a mutant as `make mutants` prints them. A `tuned` entry
names constants of a file: a change of one of their numbers is covered if its value moves by at most a twentieth, so
that 513 for 512 is, and 2 for 3 is not. `why` is the reason. What is so wherever it stands is a rule here.
"""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mutants.positions import Mutant

FOLDER = Path(__file__).parent / "equivalent"
TUNED_PART = 1 / 20
ARITHMETIC = (ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
RULES = {
    re.compile(
        r"(reshape\((?:[^()]|\([^()]*\))*?)(?:- ?[12]|~1)(?=[,)])"
    ): "To numpy, any negative length is what is left.",
    re.compile(r"(axes\b\)? )(?:== ?1|<= ?1|< ?2|!= ?2)"): "A structure has one axis or two.",
    re.compile(r"(axes\b\)? )(?:== ?2|>= ?2|> ?1|!= ?1)"): "A structure has one axis or two.",
    re.compile(r"(lru_cache\(maxsize=)(?: ?\d+)(?=\))"): "What is kept saves time only.",
}
"""Patterns of lines, mutants of which differ behind the first group alone -> why nobody could tell them."""


def listed(kind: str) -> list[dict[str, Any]]:
    """Return all entries of a kind, `equivalent` or `tuned`; `file` is from the top folder."""
    return [one for path in sorted(FOLDER.glob("*.toml")) for one in tomllib.loads(path.read_text()).get(kind, ())]


def reasons() -> dict[tuple[str, str, str], str]:
    """Return why a mutant changes nothing, by file and lines before and after."""
    return {(one["file"], one["before"].strip(), one["after"].strip()): one["why"] for one in listed("equivalent")}


def tuned() -> dict[tuple[str, str], str]:
    """Return why a number may as well be a little different, by file and name of the constant."""
    return {(one["file"], name): one["why"] for one in listed("tuned") for name in one["constants"]}


def reason_of(mutant: Mutant, text: str) -> str | None:
    """Return why a mutant of a file with this text changes nothing, if a list or a rule says so."""
    if why := reasons().get((mutant.file, mutant.before.strip(), mutant.after.strip())):
        return why
    for pattern, why in RULES.items():
        if pattern.sub(r"\1", mutant.before) == pattern.sub(r"\1", mutant.after):
            return why
    if mutant.operator != "NumberReplacer":
        return None
    old, new = constants(text), constants(mutant.text)
    changed = [name for name, value in old.items() if ast.dump(value) != ast.dump(new[name])]
    if len(changed) == 1 and _are_close(old[changed[0]], new[changed[0]]):
        return tuned().get((mutant.file, changed[0]))
    return None


def constants(text: str) -> dict[str, ast.expr]:
    """Return the values of constants and fields, at the top of a file and of its classes, by name."""
    tree = ast.parse(text)
    bodies = [tree.body, *(node.body for node in ast.walk(tree) if isinstance(node, ast.ClassDef))]
    return dict(pair for body in bodies for node in body for pair in _assigned(node))


def _assigned(node: ast.stmt) -> Iterator[tuple[str, ast.expr]]:
    if isinstance(node, ast.AnnAssign) and node.value is not None:
        yield ast.unparse(node.target), node.value
    elif isinstance(node, ast.Assign):
        (target,) = node.targets
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            yield from zip(map(ast.unparse, target.elts), node.value.elts, strict=True)
        else:
            yield ast.unparse(target), node.value


def _are_close(old: ast.expr, new: ast.expr) -> bool:
    pairs = zip(_numbers(old), _numbers(new), strict=True)
    return all(abs(after - before) <= TUNED_PART * abs(before) for before, after in pairs)


def _numbers(node: ast.AST) -> Iterator[float]:
    """Yield the values of the numbers in an expression; of arithmetic, that of the whole."""
    parts = list(ast.walk(node))
    numbers = [part for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, int | float)]
    if numbers and all(isinstance(part, ARITHMETIC) or part in numbers for part in parts):
        yield eval(ast.unparse(node), {})  # noqa: S307 - numbers only
    else:
        for child in ast.iter_child_nodes(node):
            yield from _numbers(child)
