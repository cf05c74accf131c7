"""Extreme numbers in a scene: a command answers with finite numbers, or with one line and exit 2, without a warning."""

import contextlib
import io
import json
import warnings
from pathlib import Path

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from beamtouch_common.commands import WRONG_INPUT
from beamtouch_models import cli, load_model
from beamtouch_models.design.effort import LEAST
from support.surfaces.example_scenes import INSTEAD, OPTIONS, PLAIN, Tables
from support.surfaces.wrong_numbers import numbers_in, with_value

SUPPORTS = [
    *("simply-supported", "cantilever", "fixed-fixed", "propped"),
    [{"at_mm": 0.0, "fixity": 0.2}, {"at_mm": 300.0}],
    [{"at_mm": 0.0, "slides": False}, {"at_mm": 170.0}, {"at_mm": 400.0, "kind": "fixed"}],
]
EXTREME = st.one_of(
    st.floats(),
    st.sampled_from([5e-324, 1e-310, 1e-300, 1e-30, 1e-9, 1e9, 1e30, 1e300, 0.0, -1.0]),
    st.integers(0, 70),
    st.builds(lambda near, ulps: near * (1 + ulps * 2**-52), st.sampled_from([1.0, 200.0, 400.0]), st.integers(-2, 2)),
)


@st.composite
def extreme_scenes(draw: st.DrawFn) -> Tables:
    """A scene of everyday numbers and some of the keys that there are, in which up to three numbers are extreme."""
    found = {part: dict(keys) for part, keys in PLAIN.items()}
    found["beam"]["supports"] = draw(st.sampled_from(SUPPORTS))
    for part, key in draw(st.lists(st.sampled_from(sorted(OPTIONS)), max_size=5, unique=True)):
        found[part].pop(INSTEAD.get(key, ""), None)
        found[part][key] = OPTIONS[part, key]
    for path in draw(st.lists(st.sampled_from(numbers_in(found)), min_size=1, max_size=3, unique=True)):
        found = with_value(found, path, draw(EXTREME))
    return found


def run(*arguments: str) -> tuple[int, str, str]:
    """Run a command here; a warning is a failure, as it would stand beside the one line."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("error")
        code = cli.main([*arguments, "--effort", str(LEAST)])
    return code, out.getvalue(), err.getvalue()


def refuse(constant: str) -> float:
    raise AssertionError(f"{constant} is no JSON")


@pytest.mark.parametrize(
    ("command", "examples"),
    [
        *(("explain", 60), ("place", 8)),
        *(pytest.param(*more, marks=pytest.mark.soak) for more in (("explain", 600), ("place", 100))),
    ],
)
def test_extreme_numbers_give_a_figure_or_one_line(command: str, examples: int, tmp_path: Path) -> None:
    path, options = tmp_path / "scene.toml", ("--sensors", "2") if command == "place" else ()

    @settings(max_examples=examples, suppress_health_check=list(HealthCheck))
    @given(extreme_scenes())
    def holds(stated: Tables) -> None:
        path.write_text(tomli_w.dumps(stated))
        code, out, err = run(command, str(path), *options, "--json")
        if code == 0:
            json.loads(out, parse_constant=refuse)
        else:
            assert (code, out) == (WRONG_INPUT, ""), err
            assert sum(line.startswith("design-sensors: ") for line in err.splitlines()) == 1, err

    holds()


ZEROS_FAR_ABOVE_NOISE: Tables = {
    "beam": {
        "length_mm": 158.3,
        "flexural_rigidity_n_mm2": 139.2e9,
        "supports": [
            *({"at_mm": at} for at in (34.6, 82.5, 103.3, 124.1)),
            {"at_mm": 145.3, "kind": "fixed"},
        ],
    },
    "contact": {"force_n": [198e3, 396e3], "position_mm": [2.0, 156.0]},
    "sensors": {"count": 5, "rate_hz": 8.4, "noise_mm": 1e-4, "zero_drift_mm": 0.003, "size_mm": 1.8},
    "requirements": {"latency_ms": 78e3},
}


def test_a_model_is_built_where_zeros_drift_far_more_than_readings_scatter(tmp_path: Path) -> None:
    scene, model = tmp_path / "scene.toml", tmp_path / "scene.onnx"
    scene.write_text(tomli_w.dumps(ZEROS_FAR_ABOVE_NOISE))
    code, _, err = run("build", str(scene), "-o", str(model), "--criterion", "eigenvalue-product", "--json")
    assert code == 0, err
    touch = load_model(model).metadata.thresholds.touch
    # Zeros lie within two of their deviations: alone, they move one channel by no more, which is odds of 2^2 / 2.
    assert 0 < touch[0] < 2.1
    assert touch[-1] > 1


@pytest.mark.promise(
    "docs/how-to/design.md",
    "No surface is built of sensors whose gains are known to worse than 5 % after calibration; calibrate them, or use "
    "better ones.",
)
def test_no_surface_is_built_of_sensors_whose_gains_are_hardly_known(tmp_path: Path) -> None:
    scene, model = tmp_path / "scene.toml", tmp_path / "scene.onnx"
    scene.write_text(tomli_w.dumps(PLAIN | {"sensors": PLAIN["sensors"] | {"gain_error_percent": 12.0}}))
    for command in (
        ["explain", str(scene)],
        ["place", str(scene)],
        ["build", str(scene), "-o", str(model)],
        ["trade", str(scene), "-o", str(tmp_path / "trade")],
    ):
        code, out, err = run(*command)
        assert (code, out) == (WRONG_INPUT, "")
        assert err == (
            f"design-sensors: {scene}: sensors.gain_error_percent: no surface is built of sensors whose gains are "
            "known to worse than 5 % after calibration; calibrate, or use better sensors (given: 12.0)\n"
        )
    assert list(tmp_path.iterdir()) == [scene]
    scene.write_text(tomli_w.dumps(PLAIN | {"sensors": PLAIN["sensors"] | {"gain_error_percent": 5.0}}))
    assert run("explain", str(scene))[0] == 0
