"""The Python interface as Markdown: signatures, fields and docstrings of each public name, as in the source."""

import ast
import inspect
import re
from textwrap import dedent

import beamtouch_models


def python_interface() -> str:
    """Return a heading and the stub of each public name of `beamtouch_models`."""
    stubs = {
        name: stub_of(dedent(inspect.getsource(getattr(beamtouch_models, name)))) for name in beamtouch_models.__all__
    }
    return "\n\n".join(f"## {name}\n\n```python\n{stub}\n```" for name, stub in stubs.items())


def stub_of(source: str) -> str:
    """Return the source of a function or a class without bodies of functions and without private members."""
    (outer,) = ast.parse(source).body
    members = outer.body if isinstance(outer, ast.ClassDef) else [outer]
    lines: list[str | None] = [*source.splitlines()]
    for member in members:
        if not isinstance(member, ast.FunctionDef):
            continue
        docstring = member.body[0]
        first = member.decorator_list[0] if member.decorator_list else member
        start = first.lineno - 1 if member.name.startswith("_") else docstring.end_lineno or 0
        lines[start : member.end_lineno] = [None] * ((member.end_lineno or 0) - start)
    stub = "\n".join(line for line in lines if line is not None)
    return re.sub(r"\n{3,}", "\n\n", stub).strip()
