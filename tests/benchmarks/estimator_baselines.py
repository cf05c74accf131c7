"""Usual alternatives: the paper's network, scikit-learn's regressors, the small network."""

import time
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from estimator_cases import SEED, Case, answer_of, drawn_of, in_turns
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.model_selection import GridSearchCV
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import ratio_of
from beamtouch_models.design.estimators.estimator import estimator_of
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.sweeps import silent
from beamtouch_models.runtime.session import runner

TRAINING, TRAINING_OF_PROCESS, TEST = 20_000, 1500, 4000


def baselines(case: Case) -> list[dict[str, object]]:
    """All of them on a case, with their time per answer over that of the default estimator."""
    prior, drawn, best = drawn_of(case)
    reading, truth, best = drawn.deflection_mm[:TEST], drawn.position_mm[:TEST], best[:TEST]
    calls: dict[str, Callable[[], object]] = {}
    rows = []
    for name in ("posterior", "small-network", "paper-network"):
        start = time.perf_counter()
        made = estimator_of(
            name, prior, min_noise_mm=prior.errors.noise_mm, with_force=False, seed=SEED, progress=silent
        )
        took = time.perf_counter() - start
        content, weights = to_bytes(made.graph), prior.errors.whitening(reading)
        answers = runner(content)(reading, weights)["position_mm"]
        calls[name] = answer_of(content, reading[:1], weights[:1])
        rows.append(_row(case, name, np.abs(answers - truth), best, took))
    for name, model in _regressors(prior).items():
        start = time.perf_counter()
        count = TRAINING_OF_PROCESS if name == "Gaussian process" else TRAINING
        taught = draw(prior, count, SEED + 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # of the Gaussian process' bounds; it says nothing here
            model.fit(taught.deflection_mm, taught.position_mm)
        took = time.perf_counter() - start
        calls[name] = partial(model.predict, reading[:1])
        rows.append(_row(case, name, np.abs(model.predict(reading) - truth), best, took))
    times = in_turns(calls)
    for row, name in zip(rows, calls, strict=True):
        row["us per answer"] = times[name]
        row["over posterior's"] = times[name] / times["posterior"]
    return rows


def _regressors(prior: Prior) -> dict[str, Any]:
    """scikit-learn's regressors on the direction and size of the deflection, tuned by cross validation."""
    features = FunctionTransformer(_direction_and_size, kw_args={"noise_mm": prior.errors.noise_mm})
    network = GridSearchCV(
        MLPRegressor(early_stopping=True, max_iter=300, random_state=0),
        {"hidden_layer_sizes": [(32, 32), (64, 64)], "alpha": [1e-5, 1e-3]},
        scoring="neg_mean_absolute_error",
        cv=2,
        n_jobs=2,
    )
    neighbours = GridSearchCV(
        KNeighborsRegressor(), {"n_neighbors": [5, 20, 80]}, scoring="neg_mean_absolute_error", cv=3, n_jobs=2
    )
    process = GaussianProcessRegressor(RBF(np.ones(prior.channels + 1)) + WhiteKernel(0.1), normalize_y=True)
    return {
        "MLPRegressor": make_pipeline(features, StandardScaler(), network),
        "nearest neighbours": make_pipeline(features, StandardScaler(), neighbours),
        "Gaussian process": make_pipeline(features, StandardScaler(), process),
    }


def _direction_and_size(deflection_mm: Floats, noise_mm: float) -> Floats:
    scaled = deflection_mm / noise_mm
    size = np.sqrt((scaled**2).sum(axis=1, keepdims=True) + 1)
    return np.concatenate([scaled / size, np.log(size)], axis=1)


def _row(case: Case, name: str, error: NDArray[Any], best: Floats, took_s: float) -> dict[str, object]:
    ratio = ratio_of(error.astype(np.float64), best)
    return {
        "name": f"{name}: {case}",
        "value": ratio.value,
        "unit": "mean error over limit",
        "+-": ratio.standard_error,
        "training, s": took_s,
    }
