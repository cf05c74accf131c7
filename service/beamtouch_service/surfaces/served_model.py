"""A model in use: its file, inference in fixed memory, and the decisions on the new samples of a surface."""

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.modelfile import INPUTS, Answers, Evidence, ModelFile, State, Wirings
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.estimates import Estimated, estimate
from beamtouch_service.surfaces.follower import Follower, Seen
from beamtouch_service.surfaces.timings import Timings
from beamtouch_service.surfaces.weighing import Arrangement

MAX_BOUND = 16
"""Batches of up to this many samples use memory of their own. Larger ones are rare, and take long anyway."""


class _Bound:
    """Runs a model on a fixed number of samples, always in the same memory."""

    def __init__(self, model: ModelFile, samples: int) -> None:
        self._run = model.session.run_with_iobinding
        golden = model.metadata.golden
        self._deflection_mm = np.repeat(np.array(golden.deflection_mm[:1], np.float32), samples, axis=0)
        self._whitening = np.repeat(np.array(golden.whitening_per_mm[:1], np.float32), samples, axis=0)
        # The graph decides the shapes of its outputs, so take them from an answer.
        answers = model.estimate(self._deflection_mm, self._whitening)
        self._answers = {name: np.ascontiguousarray(values) for name, values in answers.items()}
        self._binding = model.session.io_binding()
        for name, array in zip(INPUTS, (self._deflection_mm, self._whitening), strict=True):
            self._binding.bind_input(name, "cpu", 0, array.dtype.type, array.shape, array.ctypes.data)
        for name, array in self._answers.items():
            self._binding.bind_output(name, "cpu", 0, array.dtype.type, array.shape, array.ctypes.data)

    def ask(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        self._deflection_mm[:], self._whitening[:] = deflection_mm, whitening_per_mm
        self._run(self._binding)
        return self._answers


class Inference:
    """Runs a model. Small batches always use the same memory, which is a tenth faster than new arrays."""

    def __init__(self, model: ModelFile) -> None:
        self._model = model
        self._bound = {1: _Bound(model, 1)}

    def ask(self, deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
        """Return the values per output for deflections [mm] and their whitening. They hold until the next call."""
        samples = len(deflection_mm)
        if not 0 < samples <= MAX_BOUND:
            return self._model.run(deflection_mm, whitening_per_mm)
        if samples not in self._bound:
            self._bound[samples] = _Bound(self._model, samples)
        return self._bound[samples].ask(deflection_mm, whitening_per_mm)


class ServedModel:
    """A model that a surface answers from."""

    def __init__(self, file: ModelFile) -> None:
        self.file = file
        self._inference = Inference(file)
        self._arrangement: Arrangement | None = None
        self._follower: tuple[str, Follower] | None = None
        """Follows the sender with this boot id."""
        self._wirings = Wirings(file.metadata, self._inference.ask)
        self._settled: Estimated | None = None
        """The last settled sample of what acts on the beam."""

    @property
    def wiring(self) -> str | None:
        """Cables that seem to be swapped, or a sensor that seems to be inverted, in words; None if there is none."""
        return self._wirings.finding

    def arrangement(self, batch: Batch) -> Arrangement:
        """Return the channels of the model in a batch: those of the last one, if both name the same channels."""
        if self._arrangement is None or not self._arrangement.fits(batch):
            self._arrangement = Arrangement(self.file, batch)
        return self._arrangement

    def follow(self, surface: str, stale_ms: float, batch: Batch, fresh: list[Sample], timings: Timings) -> list[Seen]:
        """Decide on new samples of a batch, in order. A sender is followed from its first batch on."""

        def ask(deflection_mm: NDArray[np.floating], whitening_per_mm: NDArray[np.floating]) -> Answers:
            begin_s = perf_counter()
            answers = self._inference.ask(deflection_mm, whitening_per_mm)
            timings.inference_s.observe(perf_counter() - begin_s)
            return answers

        if self._follower is None or self._follower[0] != batch.boot_id:
            self._follower = batch.boot_id, Follower(self.file, self._inference.ask, surface, stale_ms)
        seen = self._follower[1].follow(estimate(self.file, surface, batch, fresh, ask, self.arrangement(batch)))
        for one in seen:
            self._seek_wiring(one)
        return seen

    def _seek_wiring(self, seen: Seen) -> None:
        """Look at one sample of each contact, and of each unexplained stretch, once it has been lifted."""
        estimated, said = seen.estimated, seen.estimated.evidence
        if seen.state is State.CLEAR:
            if self._settled is not None:
                self._wirings.add(self._settled.weighed.part(np.array([self._settled.row])))
            self._settled = None
        elif isinstance(said, Evidence) and said.is_settled and not said.moves and not estimated.bad:
            # The state follows a lift only after some samples: those at rest say nothing of the contact.
            at_rest = said.rest_misfit <= self.file.metadata.thresholds.rest[-1]
            self._settled = self._settled if at_rest else estimated
