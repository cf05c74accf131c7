"""A model in use: its file, and inference in fixed memory."""

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.modelfile import INPUTS, Answers, ModelFile
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.weighing import Arrangement


class Inference:
    """Runs a model. Single samples always use the same memory, which is a tenth faster than new arrays."""

    def __init__(self, model: ModelFile) -> None:
        self._model = model
        self._run = model.session.run_with_iobinding
        golden = model.metadata.golden
        self._deflection_mm = np.array(golden.deflection_mm[:1], np.float32)
        self._whitening = np.array(golden.whitening_per_mm[:1], np.float32)
        # The graph decides the shapes of its outputs, so take them from an answer.
        answers = model.estimate(self._deflection_mm, self._whitening)
        self._answers = {name: np.ascontiguousarray(values) for name, values in answers.items()}
        self._binding = model.session.io_binding()
        for name, array in zip(INPUTS, (self._deflection_mm, self._whitening), strict=True):
            self._binding.bind_input(name, "cpu", 0, array.dtype.type, array.shape, array.ctypes.data)
        for name, array in self._answers.items():
            self._binding.bind_output(name, "cpu", 0, array.dtype.type, array.shape, array.ctypes.data)

    def ask(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        """Return the values per output for deflections [mm] and their whitening. They hold until the next call."""
        if len(deflection_mm) != 1:
            return self._model.run(deflection_mm, whitening_per_mm)
        self._deflection_mm[:], self._whitening[:] = deflection_mm, whitening_per_mm
        self._run(self._binding)
        return self._answers


class ServedModel:
    """A model that a surface answers from."""

    def __init__(self, file: ModelFile) -> None:
        self.file = file
        self.inference = Inference(file)
        self._arrangement: Arrangement | None = None

    def arrangement(self, batch: Batch) -> Arrangement:
        """Return the channels of the model in a batch: those of the last one, if both name the same channels."""
        if self._arrangement is None or not self._arrangement.fits(batch):
            self._arrangement = Arrangement(self.file, batch)
        return self._arrangement
