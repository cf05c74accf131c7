"""The whitening of settled samples, for tests that ask a model directly."""

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.error_model import whitening
from beamtouch_models.modelfile import ModelFile


def settled_whitening(
    model: ModelFile, deflection_mm: NDArray[np.float32], valid: NDArray[np.bool_] | None = None
) -> NDArray[np.float32]:
    """Return the whitening of samples that hold the noise that the model was made for, and its floor."""
    said = model.metadata
    covariance_mm2 = np.eye(len(said.layout)) * said.noise.sample_mm**2
    exact = deflection_mm.astype(np.float64)
    return whitening(exact, covariance_mm2, said.floor.gain, said.floor.zero_mm, valid).astype(np.float32)
