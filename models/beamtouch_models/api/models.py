"""Model files, for scripts."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models import loading
from beamtouch_models.accuracy.evaluation import estimates
from beamtouch_models.api.beams import read_scene
from beamtouch_models.arrays import Floats
from beamtouch_models.building import build as building
from beamtouch_models.building.model_prior import prior_of_model
from beamtouch_models.errors import SceneError
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
    if not re.fullmatch(NAME, name):
        message = f"name = {name!r} must have 1 to 64 letters, digits, '_', '.' or '-'"
        raise SceneError(message)
    return building.build(stated, text, name, count=sensors, seed=seed, progress=silent).content


def load_model(model: Path | str | bytes) -> ModelFile:
    """Load a model from the path of a file, or the content of one, and reproduce its golden answers.

    `metadata` of the result has the layout, ranges, accuracy and calibration.

    Raises
    ------
    ModelFileError
        The file cannot be read, or it is not a model that can be used.
    """
    return loading.load_bytes(model, "the model") if isinstance(model, bytes) else loading.load(Path(model))


def estimate(model: ModelFile, deflection_mm: ArrayLike) -> dict[str, Floats]:
    """Return the answers of a model to settled samples of all its channels.

    Parameters
    ----------
    model : a loaded model
    deflection_mm : (samples, channels) in mm, in the order of the model's layout

    Returns
    -------
    An array (samples,) per output: `position_mm`, `position_low_mm`, `position_high_mm`, `contact_log_odds`, `misfit`,
    and with a force `force_n`, `force_low_n`, `force_high_n`.

    Raises
    ------
    SceneError
        They are not finite numbers, or not one per channel.
    """
    samples = np.atleast_2d(np.asarray(deflection_mm, dtype=np.float64))
    if samples.ndim != 2 or samples.shape[1] != len(model.channels) or not np.all(np.isfinite(samples)):
        message = (
            f"deflection_mm: give finite numbers, {len(model.channels)} for each sample: {', '.join(model.channels)}"
        )
        raise SceneError(message)
    return estimates(model, prior_of_model(model.metadata), samples)
