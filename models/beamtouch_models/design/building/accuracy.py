"""The accuracy of a scene's layouts and of models: limits, and evaluation beside them."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy import evaluation, limit
from beamtouch_models.design.accuracy.evaluation import Evaluation, at_noise
from beamtouch_models.design.accuracy.posterior import posterior_quantiles
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.physics.influence import InfluenceFunction, check_own
from beamtouch_models.design.pricing.noise import check_scale
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.surface import Surface, prior_of_model
from beamtouch_models.design.sweeps import Fraction, TaskMap, in_turn, silent
from beamtouch_models.errors import SceneError, require
from beamtouch_models.numbers import number, numbers, places_in, whole
from beamtouch_models.runtime.loading import ModelFile


@dataclass(frozen=True)
class Limit:
    """The accuracy limit of a layout: the mean position error that no estimator can beat."""

    mean_mm: float
    """Mean error in mm."""
    standard_error_mm: float
    """Standard error of that mean, as contacts are drawn at random."""
    percent: float
    """Mean error in percent of the beam's length."""


def accuracy_limit(
    scene: Scene,
    sensor_mm: ArrayLike,
    *,
    noise_mm: float | None = None,
    draws: int = 10_000,
    seed: int = 0,
    influence: InfluenceFunction | None = None,
) -> Limit:
    """Return the accuracy limit of a layout, over all contacts of the scene.

    Parameters
    ----------
    scene, sensor_mm : the scene, and (sensors,) positions in mm from the left end
    noise_mm : standard deviation of a sample; default: that of the scene behind its filter
    draws : number of simulated contacts
    seed : seed of the contacts
    influence : an influence function of your own; default: that of the scene's beam

    Raises
    ------
    SceneError
        No surface can be built of the scene, or the noise is 0.
    """
    draws, seed = whole(draws, "draws", 1), whole(seed, "seed", 0)
    prior = _prior_of(scene, sensor_mm, noise_mm, influence)
    mean = limit.accuracy_limit(prior, draws, seed)
    mm = prior.length_mm / 100
    return Limit(mean.percent * mm, mean.standard_error * mm, mean.percent)


def error_along_mm(
    scene: Scene,
    sensor_mm: ArrayLike,
    position_mm: ArrayLike,
    *,
    draws: int = 64,
    seed: int = 0,
    influence: InfluenceFunction | None = None,
) -> Floats:
    """Return the accuracy limit along the beam: the mean error of contacts at each position.

    Parameters
    ----------
    scene, sensor_mm : the scene, and (sensors,) positions in mm from the left end
    position_mm : (positions,) places of contacts, in the range of the scene
    draws, seed : number of contacts at each position, of all forces of the scene, and their seed
    influence : an influence function of your own; default: that of the scene's beam

    Returns
    -------
    (positions,) in mm. Errors as `accuracy_limit`.
    """
    draws, seed = whole(draws, "draws", 1), whole(seed, "seed", 0)
    prior, rng = _prior_of(scene, sensor_mm, None, influence), np.random.default_rng(seed)
    low, high = scene.contact.position_mm
    places = np.repeat(numbers(position_mm, "position_mm", least=low, most=high), draws)
    clean, deviation = prior.sampled(places, rng.uniform(*prior.force_n, size=len(places)))
    distance = posterior_quantiles(prior, clean + rng.normal(size=clean.shape) * deviation)[1]
    mean: Floats = distance.reshape(-1, draws).mean(axis=1)
    return mean


def evaluate(
    model: ModelFile,
    *,
    noise_mm: float | None = None,
    draws: int = 20_000,
    seed: int = 0,
    influence: InfluenceFunction | None = None,
    progress: Fraction = silent,
    spread: TaskMap = in_turn,
) -> Evaluation:
    """Measure a model beside its accuracy limit, as `design-sensors evaluate` does.

    Parameters
    ----------
    model : a loaded model
    noise_mm : standard deviation of a sample, 0 for no errors at all; default: that of the model
    draws, seed : number of simulated contacts, at least, and their seed
    influence : an influence function of your own for the simulated contacts; default: that of the model's scene, with
        the departures of its calibration
    progress, spread : called with the fraction done; maps the tasks, one after the other by default

    Raises
    ------
    SceneError
        The noise is out of proportion to the deflection, or the scene in the model cannot be computed.
    """
    require(model, ModelFile, "model", "what load_model returns")
    draws, seed, metadata = whole(draws, "draws", 1), whole(seed, "seed", 0), model.metadata
    prior = prior_of_model(metadata)
    if influence is not None:
        check_own(influence, prior.length_mm, prior.position_mm, prior.force_n)
        gain = np.array(metadata.departures.gain)
        prior = replace(prior, influence_at=partial(_scaled, influence, metadata.layout_mm, gain))
    if noise_mm is not None:
        stated_mm = numbers(noise_mm, "noise_mm", least=0.0)[0]
        check_scale(stated_mm, metadata.max_deflection_mm)
        prior = at_noise(prior, float(stated_mm))
    return evaluation.evaluate(model, prior, draws=draws, seed=seed, progress=progress, spread=spread)


def _scaled(influence: InfluenceFunction, sensor_mm: Floats, gain: Floats, load_mm: Floats) -> Floats:
    matrix: Floats = gain * influence.at(sensor_mm, load_mm)
    return matrix


def _prior_of(scene: Scene, sensor_mm: ArrayLike, noise_mm: float | None, influence: InfluenceFunction | None) -> Prior:
    require(scene, Scene, "scene", "what read_scene returns")
    sensors = places_in(sensor_mm, "sensor_mm", scene.beam.length_mm)
    surface = Surface.of(scene, own_influence=influence)
    surface.check(len(sensors))
    prior = surface.prior(sensors)
    if noise_mm is None:
        return prior
    stated_mm = number(noise_mm, "noise_mm")
    if stated_mm <= 0:
        raise SceneError(f"noise_mm = {stated_mm:g}: must be more than 0; without noise there is no accuracy limit")
    check_scale(stated_mm, surface.travel.largest_mm)
    return replace(prior, noise_mm=stated_mm)
