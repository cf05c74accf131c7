"""Offline evaluation of a graph on many samples."""

from collections.abc import Callable

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from beamtouch_models.modelfile import Answers, session_options

Run = Callable[[NDArray[np.float32], NDArray[np.bool_]], Answers]
"""Takes deflections and validity, both (batch, channels), and returns one array (batch,) per output."""

CHUNK = 256


def runner(content: bytes) -> Run:
    """Return a function that runs an ONNX file's content in chunks that fit the cache."""
    session = ort.InferenceSession(content, session_options(), providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]

    def run(deflection_mm: NDArray[np.float32], valid: NDArray[np.bool_]) -> Answers:
        chunks = [slice(start, start + CHUNK) for start in range(0, len(deflection_mm), CHUNK)]
        parts = [session.run(None, {"deflection_mm": deflection_mm[c], "valid": valid[c]}) for c in chunks]
        return {name: np.concatenate([part[index] for part in parts]) for index, name in enumerate(names)}

    return run
