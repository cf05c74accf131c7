"""The identity of a beam with its layout: the same for every model of it, whatever else its scene states."""

import hashlib
import json
from collections.abc import Mapping

from beamtouch_models.scene.beam import Beam

DIGITS = 12
"""Hex digits of an identity. Two beams of a million have the same one with a probability of 0.002."""


def identity_of(beam: Beam, sensors_mm: Mapping[str, float]) -> str:
    """Return the identity of a beam with sensors, by the names of their channels, at these positions [mm].

    It stands for what decides how the sensors move under a load: length, rigidity, supports, foundation, positions and
    names. Noise, drift, ranges, requirements and the estimator have no part in it, and neither has a calibration. The
    order of the channels has none either, because samples name them. Six digits of each number count.
    """
    shear = beam.shear_modulus_gpa
    stated = {
        "length_mm": _text(beam.length_mm),
        "sections": [
            [_text(one.to_mm), _text(one.rigidity_n_mm2), _text(one.area_mm2 if shear is not None else None)]
            for one in beam.sections
        ],
        "shear_modulus_gpa": _text(shear),
        "foundation_n_mm2": _text(beam.foundation_n_mm2),
        # Sliding lengthwise moves no sensor.
        "supports": [
            [value if key == "kind" else _text(value) for key, value in support if key != "slides"]
            for support in beam.support_list
        ],
        "sensors_mm": {name: _text(position_mm) for name, position_mm in sensors_mm.items()},
    }
    return hashlib.sha256(json.dumps(stated, sort_keys=True).encode()).hexdigest()[:DIGITS]


def _text(number: float | None) -> str:
    # 0.0 is added because -0.0 is another text.
    return "" if number is None else f"{number + 0.0:.6g}"
