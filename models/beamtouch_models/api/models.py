"""Model files, for scripts."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.digits import digits
from beamtouch_models import loading
from beamtouch_models.api.beams import read_scene
from beamtouch_models.api.numbers import array_of, require, whole
from beamtouch_models.arrays import Floats
from beamtouch_models.building import build as building
from beamtouch_models.errors import ModelFileError, SceneError
from beamtouch_models.loading import ModelFile
from beamtouch_models.metadata.fields import NAME
from beamtouch_models.progress import silent


def build(scene: Path | str, name: str = "surface", *, sensors: int | None = None, seed: int = 0) -> bytes:
    """Build the model of a scene, as `design-sensors build` does.

    Parameters
    ----------
    scene : path of a TOML file, or TOML text
    name : name of the surface
    sensors : number of sensors; default: as the scene states
    seed : seed of all random numbers; the same seed gives the same bytes

    Returns
    -------
    The content of the model file.

    Raises
    ------
    InputError
        It is not a scene.
    SceneError
        The scene cannot be built; the message says why.
    """
    stated, text = read_scene(scene), scene.read_text() if isinstance(scene, Path) else scene
    count, seed = None if sensors is None else whole(sensors, "sensors", 1), whole(seed, "seed", 0)
    require(name, str, "name", "text")
    if not re.fullmatch(NAME, name):
        message = f"name = {name!r} must have 1 to 64 letters, digits, '_', '.' or '-'"
        raise SceneError(message)
    return building.build(stated, text, name, count=count, seed=seed, progress=silent).content


def load_model(model: Path | str | bytes) -> ModelFile:
    """Load a model from the path of a file, or the content of one, and reproduce its golden answers.

    `metadata` of the result has the layout, ranges, accuracy and calibration.

    Raises
    ------
    ModelFileError
        The file cannot be read, or it is not a model that can be used.
    """
    if isinstance(model, bytes):
        return loading.load_bytes(model, "the model")
    if not isinstance(model, Path | str):
        message = f"the model: give a path or the content of a file, not {type(model).__name__}"
        raise ModelFileError(message)
    return loading.load(Path(model))


def estimate(model: ModelFile, deflection_mm: ArrayLike) -> dict[str, Floats]:
    """Return the answers of a model to settled samples of all its channels, as the service gives them.

    Parameters
    ----------
    model : a loaded model
    deflection_mm : (samples, channels) in mm, as the sensors measure them, in the order of the model's layout

    Returns
    -------
    An array (samples,) per output: `position_mm`, `position_low_mm`, `position_high_mm`, `contact_log_odds`, `misfit`,
    and with a force `force_n`, `force_low_n`, `force_high_n`.

    Raises
    ------
    SceneError
        They are not numbers that the sensors can measure, or not one per channel.
    """
    require(model, ModelFile, "model", "what load_model returns")
    samples = np.atleast_2d(array_of(deflection_mm, "deflection_mm"))
    names = model.channels
    if samples.ndim != 2 or samples.shape[1] != len(names) or not np.all(np.isfinite(samples)):
        message = f"deflection_mm: give finite numbers, {len(names)} for each sample: {', '.join(names)}"
        raise SceneError(message)
    if np.abs(samples).max(initial=0.0) > model.largest_mm:
        message = f"deflection_mm: no load deflects this beam by more than {digits(model.largest_mm, 3)} mm"
        raise SceneError(message)
    return model.answer(samples)
