"""Wrong arguments of the interface for scripts: each is refused with one line that says what to give."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beamtouch_models as models
from beamtouch_common.errors import InputError
from support.surfaces.example_scenes import SCENES

SCENE = (SCENES / "bench.toml").read_text()


@pytest.fixture
def scene() -> models.Scene:
    return models.read_scene(SCENES / "bench.toml")


def own(
    length_mm: float = 400.0, load_mm: tuple[float, float] = (1.0, 399.0), force_n: tuple[float, float] = (2.0, 20.0)
) -> models.InfluenceFunction:
    """An influence function of a script's own."""
    return models.InfluenceFunction(length_mm, np.array(load_mm), force_n, lambda sensor, load: np.outer(load, sensor))


COLUMNS, ROWS, TABLE = [0, 200, 400], [1, 200, 399], np.outer([1, 5, 1], [0, 3, 0])
S = "the scene"
"""It stands for the scene in the arguments below."""


@pytest.mark.parametrize(
    ("link", "name", "arguments", "options", "said"),
    [
        ("models", "influence_matrix", (S, [700], [10]), {}, r"sensor_mm: must be finite from 0 to 400"),
        ("models", "influence_matrix", (S, [10], []), {}, "load_mm: must be one number, or a list of them"),
        ("models", "influence_matrix", (S, ["a"], [10]), {}, "sensor_mm: must be numbers"),
        ("surface", "layout", ([np.nan],), {}, r"positions_mm: must be finite .* \(given: nan\)"),
        ("layout", "limit", (), {"draws": 0}, "draws = 0: give a whole number, 1 or more"),
        ("layout", "limit", (), {"noise_mm": np.nan}, r"noise_mm: must be finite \(given: nan"),
        ("layout", "limit", (), {"noise_mm": 0}, "noise_mm = 0: must be more than 0"),
        ("layout", "error_along", ([-5],), {}, "position_mm: must be finite from 1 to 399"),
        ("surface", "place", (0,), {}, "sensors = 0: give a whole number, 1 or more"),
        ("surface", "place", (3,), {"seed": -1}, "seed = -1: give a whole number, 0 or more"),
        ("models", "resolve", ("bench.toml",), {}, "scene: give what read_scene or make_scene returns, not str 'bench"),
        ("surface", "place", (4,), {"criterion": "best"}, "criterion = 'best' must be one of position-"),
        ("surface", "place", (1,), {"failed_percent": 100}, "failed_percent = 100 needs at least 2 sensors, not 1"),
        ("models", "ringing_mm", (S, [1], [-1]), {}, r"time_s: must be finite, at least 0 \(given: -1\)"),
        ("models", "ringing_mm", (S, [1], [0]), {"damping_ratio": 2}, "damping_ratio = 2 must be more than 0"),
        ("models", "read_scene", ("absent.toml",), {}, "absent.toml: No such file"),
        ("models", "read_scene", (5,), {}, "the scene: give a path or TOML text, not int"),
        ("layout", "build", ("my name",), {}, "name = 'my name' must have 1 to 64 letters"),
        ("layout", "build", (), {"estimator": "best"}, "estimator = 'best' must be one of"),
        ("surface", "layout", ([100.0, 101.0],), {}, "mm apart"),
        ("surface", "layout", ([20.0, 900.0],), {}, "positions_mm: must be finite from 0 to 400"),
        ("surface", "layout", (np.linspace(5, 395, 65),), {}, "positions_mm: give at most 64 positions, not 65"),
        ("surface", "layout", ([20.0, 90.0, 20.0],), {}, "positions_mm: it has 20 mm twice; two sensors"),
        ("surface", "layout", ([0.0, 200.0],), {}, "beyond the end"),
        ("models", "load_model", ("missing.onnx",), {}, "missing.onnx: No such file"),
        ("models", "load_model", ("a\0b",), {}, r"'a\\x00b' cannot be the path of a file"),
        ("model", "estimate", ([[1, 2, 3]],), {}, "deflection_mm: give numbers in mm, 4 for each sample: s1"),
        ("model", "estimate", ([1, np.inf, 1, 1],), {}, r"4 for each sample: s1, s2, s3, s4 \(given: one that is inf"),
        ("model", "estimate", ([1, np.nan, np.nan, np.nan],), {}, "of a sample, 1 of 4 channels take part, but the"),
        ("model", "evaluate", (), {"missing": "s1"}, r"missing: give a list of some of s1, s2, s3, s4 \(given: 's1'"),
        ("model", "evaluate", (), {"missing": ["s9"]}, r"missing: give a list of .* \(given: s9\)"),
        ("model", "evaluate", (), {"missing": ["s1", "s2", "s3"]}, "missing: without s1, s2, s3, 1 of 4 channels take"),
        (
            "model",
            "estimate",
            ([1, 2, 3, 1e30],),
            {},
            r"1e\+30 is more than 100 times the largest deflection of the scene",
        ),
        ("model", "estimate", (["1", "2", "3", "4"],), {}, "deflection_mm: must be numbers"),
        ("models", "interpolate_influence", (S, [0, 400], ROWS, TABLE), {}, "sensor_mm: give 3 or more ascending"),
        (
            "models",
            "interpolate_influence",
            (S, [0, 200, 390], ROWS, TABLE),
            {},
            "sensor_mm: give places from 0 mm, or",
        ),
        (
            "models",
            "interpolate_influence",
            (S, COLUMNS, [1, 100, 200], TABLE),
            {},
            "load_mm: give places from 1 mm, or",
        ),
        (
            "models",
            "interpolate_influence",
            (S, COLUMNS, ROWS, TABLE[:2]),
            {},
            "matrix: give 3 rows, one for each load",
        ),
        ("models", "interpolate_influence", (S, COLUMNS, ROWS, np.zeros((3, 3))), {}, "numbers that are not all 0"),
        ("models", "interpolate_influence", (S, COLUMNS, ROWS, TABLE), {}, "mm apart are too coarse: splines of the"),
        ("models", "resolve", (S,), {"influence": np.eye(3)}, "influence: give an InfluenceFunction, not ndarray"),
        ("models", "resolve", (S,), {"influence": own()}, "beam: an influence function of your own takes its place"),
        (
            "model",
            "evaluate",
            (),
            {"influence": own(300.0, (1.0, 299.0))},
            "influence: its length_mm is 300, but that of the scene",
        ),
        (
            "models",
            "resolve",
            (S,),
            {"influence": own(force_n=(20.0, 200.0))},
            "its force_n is 20 to 200, but that of",
        ),
        (
            "model",
            "evaluate",
            (),
            {"influence": own(load_mm=(10.0, 290.0))},
            "its load_mm is 10 to 290, but that of the scene",
        ),
        ("models", "change_scene", (SCENE,), {}, "scene: give what read_scene or make_scene returns, not str"),
        (
            "models",
            "change_scene",
            (S,),
            {"sensors": 5},
            "sensors: give a table, as a dict of its keys, not int",
        ),
        ("models", "format_scene", (SCENE,), {}, "scene: give what read_scene or make_scene returns, not str"),
        ("model", "evaluate", (), {"noise_mm": -1}, "noise_mm: must be finite, at least 0"),
    ],
)
def test_a_wrong_argument_is_refused_in_one_line(
    scene: models.Scene,
    bench_model: Path,
    link: str,
    name: str,
    arguments: tuple[object, ...],
    options: dict[str, Any],
    said: str,
) -> None:
    surface = models.resolve(scene)
    links = {
        "models": models,
        "surface": surface,
        "layout": surface.layout([100.0, 300.0]),
        "model": models.load_model(bench_model),
    }
    given = [scene if one is S else one for one in arguments]
    with pytest.raises(InputError, match=said) as caught:
        getattr(links[link], name)(*given, **options)
    assert "\n" not in str(caught.value)
