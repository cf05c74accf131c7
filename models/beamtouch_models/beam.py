"""The influence matrix: deflection at each sensor per newton, for each load position."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamtouch_models.errors import SceneError
from beamtouch_models.scene import Beam, Scene

Array = NDArray[np.float64]

MAX_SLOPE = 0.1
"""Slope in rad from which (1 + slope^2)^(3/2), which small-angle theory leaves out, is off by more than 1.5 %."""


def influence(beam: Beam, sensor_mm: ArrayLike, load_mm: ArrayLike) -> Array:
    """Deflection at each sensor per newton, for each load position.

    Parameters
    ----------
    beam : the beam
    sensor_mm : (sensors,) positions in mm from the left end
    load_mm : (loads,) positions in mm from the left end

    Returns
    -------
    (loads, sensors) in mm/N, positive in the direction of the load.

    Raises
    ------
    ValueError
        A position is not finite or not on the beam.
    """
    sensor = _on_beam(beam, sensor_mm, "sensor_mm")
    load = _on_beam(beam, load_mm, "load_mm")
    scale = beam.length_mm / beam.rigidity_n_mm2 * beam.length_mm * beam.length_mm
    return scale * _simply_supported(sensor[None, :], load[:, None])


def _simply_supported(x: Array, a: Array) -> Array:
    """Deflection at x of a load at a, both over the length, in units of F l^3/(EI).

    Gere & Goodno, Mechanics of Materials, table H-2 case 5: b x (l^2 - b^2 - x^2) / 6 for x <= a, b = 1 - a. The
    bracket cancels near the ends; here it is 2 a b + (a - x)(a + x), a sum of positive terms. By reciprocity the left
    and the right point serve both orders of x and a.
    """
    left, right = np.minimum(x, a), np.maximum(x, a)
    from_right_end = 1 - right
    bracket = 2 * right * from_right_end + (right - left) * (right + left)
    deflection: Array = left * from_right_end * bracket / 6
    return deflection


def _on_beam(beam: Beam, position_mm: ArrayLike, name: str) -> Array:
    """Return positions over the length; refuse what is not a position on the beam."""
    position = np.atleast_1d(np.asarray(position_mm, dtype=np.float64))
    if position.ndim != 1 or position.size == 0:
        message = f"{name} must be a non-empty list of positions"
        raise ValueError(message)
    if not np.all(np.isfinite(position)) or position.min() < 0 or position.max() > beam.length_mm:
        message = f"{name} must be finite and lie on the beam, 0..{beam.length_mm:g} mm"
        raise ValueError(message)
    return position / beam.length_mm


def load_positions_mm(scene: Scene) -> Array:
    """Load positions that the components are computed from: every 1/400 of the length, as in the paper."""
    low, high = scene.contact.position_mm
    steps = max(1, round((high - low) / scene.beam.length_mm * 400))
    return np.linspace(low, high, steps + 1)


def max_deflection_mm(scene: Scene) -> float:
    """Return the largest deflection in the scene, anywhere on the beam, at the largest force, in mm."""
    points = np.linspace(0.0, scene.beam.length_mm, 801)
    per_newton = influence(scene.beam, points, load_positions_mm(scene)).max()
    return float(per_newton * scene.contact.force_range_n[1])


def check_small_angles(scene: Scene) -> None:
    """Refuse a scene whose deflection is beyond small-angle theory; raises SceneError."""
    points = np.linspace(0.0, scene.beam.length_mm, 801)
    shapes = influence(scene.beam, points, load_positions_mm(scene)) * scene.contact.force_range_n[1]
    slope = float(np.abs(np.diff(shapes, axis=1)).max() / (points[1] - points[0]))
    if not slope <= MAX_SLOPE:
        message = (
            f"at {scene.contact.force_range_n[1]:g} N the beam slopes by {slope:.3g} rad, beyond the {MAX_SLOPE:g} rad "
            "of small-angle theory; make the beam stiffer or the force smaller"
        )
        raise SceneError(message)
