"""Scenes, influence lines and ringing, for scripts."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.errors import InputError
from beamtouch_models.api.numbers import number, numbers, places_in, require
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import scene_influence
from beamtouch_models.physics.dynamics import damping_of, first_frequency_hz
from beamtouch_models.pricing.noise import MAX_DEFLECTION_MM
from beamtouch_models.rig.ringing import Mode
from beamtouch_models.scene import Scene, load_scene, parse_scene


def read_scene(scene: Path | str) -> Scene:
    """Read a scene.

    Parameters
    ----------
    scene : path of a TOML file, or TOML text

    Raises
    ------
    InputError
        The file cannot be read, or it is not a scene; the message names the key.
    """
    if not isinstance(scene, Path | str):
        message = f"the scene: give a path or TOML text, not {type(scene).__name__}"
        raise InputError(message)
    if isinstance(scene, str) and "\n" not in scene and scene.endswith(".toml"):
        message = f"the scene: {scene} is taken as TOML text; for a file, give Path({scene!r})"
        raise InputError(message)
    return load_scene(scene)[0] if isinstance(scene, Path) else parse_scene(scene, "the scene")


def influence_matrix(scene: Scene, sensor_mm: ArrayLike, load_mm: ArrayLike) -> Floats:
    """Return the deflection at each sensor per newton, for each place of the load.

    Parameters
    ----------
    scene : the scene
    sensor_mm : (sensors,) positions in mm from the left end
    load_mm : (loads,) positions in mm from the left end

    Returns
    -------
    (loads, sensors) in mm/N, positive in the direction of the load.

    Raises
    ------
    SceneError
        A position is not on the beam, or the beam cannot be computed.
    """
    require(scene, Scene, "scene", "what read_scene returns")
    length_mm = scene.beam.length_mm
    sensors, loads = places_in(sensor_mm, "sensor_mm", length_mm), places_in(load_mm, "load_mm", length_mm)
    return scene_influence(scene, sensors, loads)


def frequency_hz(scene: Scene) -> float:
    """Return the first natural frequency of a beam, in Hz.

    Raises
    ------
    SceneError
        The scene does not state density, width and thickness.
    """
    require(scene, Scene, "scene", "what read_scene returns")
    found = first_frequency_hz(scene.beam)
    if found is None:
        message = "beam: state density_kg_m3, width_mm and thickness_mm; they set its frequency"
        raise SceneError(message)
    return found


def ringing_mm(scene: Scene, static_mm: ArrayLike, time_s: ArrayLike, *, damping_ratio: float | None = None) -> Floats:
    """Return the deflections after a sudden load, which rings in the first mode of the beam.

    Parameters
    ----------
    scene : the scene
    static_mm : (sensors,) deflections once the beam has come to rest
    time_s : (times,) since the load acts, 0 or more
    damping_ratio : of the first mode, between 0 and 1; default: that of the scene, or 0.01

    Returns
    -------
    (times, sensors) in mm. Errors as `frequency_hz`.
    """
    require(scene, Scene, "scene", "what read_scene returns")
    ratio = damping_of(scene.beam) if damping_ratio is None else number(damping_ratio, "damping_ratio")
    if not 0 < ratio < 1:
        message = f"damping_ratio = {ratio:g} must be more than 0 and less than 1"
        raise SceneError(message)
    mode, static = (
        Mode(frequency_hz(scene), ratio),
        numbers(static_mm, "static_mm", least=-MAX_DEFLECTION_MM, most=MAX_DEFLECTION_MM),
    )
    rest, times = np.zeros_like(static), numbers(time_s, "time_s", least=0.0)
    return np.array([mode.after(float(time), static, rest, rest)[0] for time in times])
