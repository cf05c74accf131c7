"""Extreme numbers in a scene: a command answers with finite numbers, or with one line and exit 2."""

import contextlib
import io
import json
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from beamtouch_common import commands
from beamtouch_models import cli

Scene = dict[str, dict[str, Any]]

KEYS = {
    "beam": ["length_mm", "flexural_rigidity_n_mm2", "youngs_modulus_gpa", "shear_modulus_gpa", "foundation_n_mm2"],
    "contact": ["force_n", "width_mm"],
    "sensors": ["noise_mm", "noise_percent_of_max", "rate_hz", "standoff_mm", "min_distance_mm", "grid_mm"],
    "requirements": ["latency_ms", "position_error_mm"],
}
SECTION = ["width_mm", "thickness_mm", "density_kg_m3"]
NUMBERS = {(part, key) for part, keys in {**KEYS, "beam": [*KEYS["beam"], *SECTION]}.items() for key in keys}
LISTS = [("contact", "position_mm"), ("contact", "force_n"), ("sensors", "range_mm"), ("sensors", "fixed_mm")]
EXTREME = st.one_of(
    st.floats(),
    st.sampled_from([5e-324, 1e-310, 1e-300, 1e-30, 1e-9, 1e9, 1e30, 1e300, 0.0, -1.0]),
    st.integers(0, 70),
    st.builds(lambda near, ulps: near * (1 + ulps * 2**-52), st.sampled_from([1.0, 200.0, 400.0]), st.integers(-2, 2)),
)
SUPPORTS = ["simply-supported", "cantilever", "fixed-fixed", "propped", [{"at_mm": 0.0}, {"at_mm": 300.0}]]


def scene(section: bool = True) -> Scene:
    beam: dict[str, Any] = {"length_mm": 400.0}
    own = {"youngs_modulus_gpa": 210.0, "width_mm": 25.0, "thickness_mm": 3.0, "density_kg_m3": 7850.0}
    return {
        "beam": {**beam, **(own if section else {"flexural_rigidity_n_mm2": 1.18e7})},
        "contact": {"force_n": [2.0, 20.0], "position_mm": [1.0, 399.0]},
        "sensors": {"count": 2, "noise_mm": 0.01, "range_mm": [1.0, 4.0], "grid_mm": 8.0, "rate_hz": 200.0},
        "requirements": {"latency_ms": 20.0},
    }


@st.composite
def extreme_scenes(draw: st.DrawFn) -> Scene:
    """A scene of everyday numbers, of which up to two are extreme."""
    found = scene(draw(st.booleans()))
    found["beam"]["supports"] = draw(st.sampled_from(SUPPORTS))
    if draw(st.booleans()):
        found["sensors"]["adc_bits"] = draw(st.integers(5, 17))
    for _ in range(draw(st.integers(1, 2))):
        part, key = draw(st.sampled_from(sorted(NUMBERS)))
        found[part][key] = draw(EXTREME)
        if key.startswith("noise"):
            found["sensors"] = {**found["sensors"]}
            found["sensors"].pop({"noise_percent_of_max": "noise_mm"}.get(key, ""), None)
    if draw(st.booleans()):
        part, key = draw(st.sampled_from(LISTS))
        found[part][key] = [draw(EXTREME), draw(EXTREME)]
    return found


def text_of(value: object) -> str:
    """TOML of a value."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {text_of(part)}" for key, part in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(text_of, value))}]"
    return json.dumps(value) if isinstance(value, str) else repr(value)


def written(path: Path, stated: Scene) -> Path:
    lines = [
        line
        for part, keys in stated.items()
        for line in (f"[{part}]", *(f"{key} = {text_of(value)}" for key, value in keys.items()))
    ]
    path.write_text("\n".join(lines))
    return path


def run(*arguments: str) -> tuple[int, str, str]:
    """Run a command here; a warning is a failure, as it would stand beside the one line."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("error")
        code = cli.main(arguments)
    return code, out.getvalue(), err.getvalue()


def numbers_in(value: object) -> Iterator[float]:
    if isinstance(value, dict):
        for part in value.values():
            yield from numbers_in(part)
    elif isinstance(value, list):
        for part in value:
            yield from numbers_in(part)
    elif isinstance(value, float):
        yield value


def check_answered(code: int, out: str, err: str) -> None:
    if code == 0:
        assert all(math.isfinite(number) for number in numbers_in(json.loads(out)))
        return
    assert code == commands.WRONG_INPUT, err
    assert out == ""
    assert len([line for line in err.splitlines() if line.startswith("design-sensors: ")]) == 1, err


@pytest.mark.parametrize(("command", "examples"), [("explain", 60), ("place", 8)])
def test_extreme_numbers_give_a_figure_or_one_line(command: str, examples: int, tmp_path: Path) -> None:
    arguments = ["--sensors", "2"] if command == "place" else []

    @settings(max_examples=examples, suppress_health_check=list(HealthCheck))
    @given(extreme_scenes())
    def holds(stated: Scene) -> None:
        path = written(tmp_path / "scene.toml", stated)
        check_answered(*run(command, str(path), *arguments, "--json"))

    holds()
