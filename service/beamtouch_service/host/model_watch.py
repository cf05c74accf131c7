"""Replaces the model of a running surface when its file changes. A file that cannot be used changes nothing."""

import asyncio
import logging
import os
import time
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from beamtouch_models import modelfile
from beamtouch_models.modelfile import GraphError, ModelFile, ModelFileError, graph_errors
from beamtouch_service.surfaces.served_model import Inference
from beamtouch_service.surfaces.surface import Surface

STILL_S = 1.0
"""A file is read once its size and time of change have been stable for this long. Before, a copy may be incomplete."""
_ATTEMPTS = 10
MAX_ANSWER_S = 0.1
"""Longest time for one answer: a thousand times that of a real model. Everything else waits meanwhile."""

_log = logging.getLogger("beamtouch.service")


@dataclass(frozen=True)
class _Stamp:
    """Changes when a file is written or replaced."""

    size: int
    changed_ns: int
    inode: int
    status_ns: int
    """Also changes with owner, mode or name."""


def parse(content: bytes, origin: str) -> ModelFile:
    """Load a model and check that a service can use it. Errors name `origin`. Raises ModelFileError."""
    model = modelfile.load_bytes(content, origin)
    if model.lacks:
        # The service states intervals, and says when nothing or no single contact explains a sample.
        message = (
            f"{origin}: a service needs more outputs than it has; build a model with another estimator "
            f"({model.metadata.estimator} lacks {', '.join(model.lacks)})"
        )
        raise ModelFileError(message)
    try:
        with graph_errors():
            answer_s = _answer_s(Inference(model), model)
    except GraphError as error:
        message = f"{origin}: its graph cannot be run as a service does ({error})"
        raise ModelFileError(message) from None
    if answer_s > MAX_ANSWER_S:
        message = (
            f"{origin}: one answer takes {answer_s * 1e3:.0f} ms, which is over the limit of "
            f"{MAX_ANSWER_S * 1e3:.0f} ms; build a simpler model"
        )
        raise ModelFileError(message)
    return model


def _answer_s(inference: Inference, model: ModelFile) -> float:
    """Return the shortest of a few answer times [s], because the machine may be busy."""
    golden, durations = model.metadata.golden, list[float]()
    inputs = (np.array(golden.deflection_mm[:1], np.float32), np.array(golden.whitening_per_mm[:1], np.float32))
    for _ in range(3):
        begin_s = time.perf_counter()
        inference.ask(*inputs)
        durations.append(time.perf_counter() - begin_s)
    return min(durations)


def load(path: Path) -> tuple[ModelFile, str]:
    """Load a model file as `parse` does. Return the digest of its content too. Raises ModelFileError."""
    content = modelfile.read(path)
    return parse(content, str(path)), _digest(content)


class ModelKeeper:
    """Keeps the model of a surface in step with its file."""

    def __init__(self, surface: Surface, path: Path, digest: str) -> None:
        self.surface = surface
        self.path = path
        self._tried = _stamp(path)
        self._candidate = self._tried
        self._digest = digest
        """Digest of the file whose model is in use."""
        self._waiting: ModelFile | None = None
        """A model that was refused because the samples of its beam, or of its channels, do not arrive yet."""
        self._lock = asyncio.Lock()

    async def poll(self) -> None:
        """Load the file if it has changed and was stable since the last poll, a second ago.

        A file that was refused because its samples did not arrive is loaded again once they do.
        """
        stamp = _stamp(self.path)
        if stamp is not None and stamp == self._candidate and (stamp != self._tried or self._is_due()):
            await self.reload()
        self._candidate = stamp

    def _is_due(self) -> bool:
        return self._waiting is not None and not self._mismatch(self._waiting)

    async def reload(self) -> bool:
        """Load the file. Return whether the surface has another model now.

        A model of another beam than the samples state is refused, and so is one whose channels they lack.

        Raises nothing: the log and `surface.model_error` say why a file was refused.
        """
        async with self._lock:
            try:
                changed = await self._reload()
            except ModelFileError as error:
                self._refuse(error)
                return False
            self.surface.model_error = None
            return changed

    def _refuse(self, error: ModelFileError) -> None:
        if self.surface.model is None:
            self.surface.model_error = str(error)
            _log.error("surface %s: no contact until its model file can be used: %s", self.surface.name, error)
            return
        self.surface.model_error = f"the old model stays in use: {error}"
        _log.error("surface %s: the new model cannot be used, the old one stays in use: %s", self.surface.name, error)

    async def _reload(self) -> bool:
        self._waiting = None
        content = await self._settled_content()
        digest, old = await asyncio.to_thread(_digest, content), self.surface.model
        if digest == self._digest:
            return False
        # In a thread, because requests go on meanwhile.
        model = await asyncio.to_thread(parse, content, str(self.path))
        if mismatch := self._mismatch(model):
            self._waiting = model
            message = f"{self.path}: {mismatch}"
            raise ModelFileError(message)
        self.surface.adopt(model)
        self._digest = digest
        _log.info(
            "surface %s: model %s instead of %s", self.surface.name, model.identity, old.identity if old else "none"
        )
        return True

    async def _settled_content(self) -> bytes:
        """Return the content of the file once it is stable."""
        for _ in range(_ATTEMPTS):
            before = _stamp(self.path)
            if before is None or abs(time.time() - before.changed_ns / 1e9) < STILL_S:
                await asyncio.sleep(STILL_S)
            # Counts as tried even if it cannot be read. If it is missing, any file that appears is new.
            self._tried = before
            content = await asyncio.to_thread(modelfile.read, self.path)
            after = _stamp(self.path)
            if before == after and after is not None and len(content) == after.size:
                return content
        self._tried = None
        message = f"{self.path}: it is still being written; try again when it is complete"
        raise ModelFileError(message)

    def _mismatch(self, model: ModelFile) -> str:
        """Return what keeps a model from the samples that arrive; empty if nothing does.

        Where they state no beam, the model must be of the same beam as the one in use.
        """
        old, new_beam = self.surface.model, model.metadata.beam
        beam = self.surface.sender_beam or (old.metadata.beam if old else None)
        if beam not in {None, new_beam}:
            whose = "the samples are" if self.surface.sender_beam else "the model in use is"
            return (
                f"it is of beam {new_beam}, {whose} of beam {beam}; to switch to another beam, give the daemon the "
                "configuration that was built with this model, and restart it"
            )
        offered = self.surface.offered
        missing = [name for name in model.channels if offered is not None and name not in offered]
        return f"it needs {', '.join(missing)}, but the samples of this surface lack them" if missing else ""


def _stamp(path: Path) -> _Stamp | None:
    try:
        found = os.stat(path)  # noqa: PTH116  # a third of the time of Path.stat, once a second for every surface
    except OSError:
        return None
    return _Stamp(found.st_size, found.st_mtime_ns, found.st_ino, found.st_ctime_ns)


def _digest(content: bytes) -> str:
    return sha256(content).hexdigest()
