"""Each public name of `beamtouch_models` has an example that prints what it says."""

import doctest
import io
from pathlib import Path

import numpy as np
import pytest

import beamtouch_models as models

OPTIONS = doctest.NORMALIZE_WHITESPACE


@pytest.mark.long
def test_examples_in_docstrings_print_what_they_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the names go on from that of the package, as its docstring says."""
    monkeypatch.chdir(tmp_path)
    given: dict[str, object] = {name: getattr(models, name) for name in models.__all__} | {"np": np}
    parser, runner, said = doctest.DocTestParser(), doctest.DocTestRunner(optionflags=OPTIONS), io.StringIO()
    names = [name for name in models.__all__ if not name.endswith("Error")]
    for name in ("", *names):
        text: str = (getattr(models, name) if name else models).__doc__ or ""
        example = parser.get_doctest(text, given, name or "beamtouch_models", None, 0)
        assert example.examples, f"{name} has no example"
        runner.run(example, out=said.write, clear_globs=False)
        if not name:
            given = {**given, **{made: example.globs[made] for made in ("scene", "surface", "layout", "model")}}

    assert not runner.failures, said.getvalue()
