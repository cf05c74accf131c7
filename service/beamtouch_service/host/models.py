"""Model files of a service: loading them, and replacing the model of a running surface when its file changes."""

import asyncio
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from beamtouch_common.errors import InputError
from beamtouch_common.outline import BEAM_AXES
from beamtouch_common.zones import first_conflict
from beamtouch_models import runtime
from beamtouch_models.runtime import ModelFile, ModelFileError
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.model_description import describe_model
from beamtouch_service.surfaces.surface import Surface

POLL_S = 1.0
"""Time between two looks at the files. Two looks that find the same new file show that it is complete."""
Stamp = tuple[int, int, int, int]
"""Size, times of change [ns] of content and status, and number of a file: differs when it is written or replaced."""

_log = logging.getLogger(__name__)


def load(path: Path) -> ModelFile:
    """Load a model and check that a service can use it; raises ModelFileError."""
    return parse(runtime.read(path), str(path))


def name_axes(surface: str, path: Path | None) -> tuple[str, tuple[str, ...]]:
    """Return the name of a surface, or of its model if it has none, and the axes of its model.

    Without a model, or before its file is there, they are those of a beam, as in a service. Raises InputError if the
    model cannot be read, or gives the name and is not there.
    """
    if surface and path and not path.exists():
        return surface, BEAM_AXES
    try:
        metadata = load(path).metadata if path else None
    except ModelFileError as error:
        raise InputError(f"model {error}") from None
    return (surface or metadata.name, tuple(metadata.axes)) if metadata else (surface, BEAM_AXES)


def report(path: Path, *, as_json: bool) -> str:
    """Return the description of a model; raises InputError if a service would refuse it."""
    try:
        model = load(path)
    except ModelFileError as error:
        raise InputError(f"model {error}") from None
    return describe_model(model).model_dump_json() if as_json else model.summary()


def parse(content: bytes, origin: str) -> ModelFile:
    """Return the model of a file's content as `load` does; `origin` is named in errors."""
    model = runtime.load_bytes(content, origin)
    if model.lacks:
        # The service states intervals, and says when nothing or no single contact explains a sample.
        message = (
            f"{origin}: a service needs more outputs than it has; build a model with another estimator "
            f"({model.metadata.estimator} lacks {', '.join(model.lacks)})"
        )
        raise ModelFileError(message)
    return model


def find_zone_conflict(section: SurfaceSection, model: ModelFile) -> str:
    """Return the first zone of a surface that a model cannot answer for, and why; empty if there is none."""
    return first_conflict(section.zones, model.metadata.outline, estimates_force="force_n" in model.outputs)


class ModelKeeper:
    """Keeps the model of a surface in step with its file. A file that cannot be used changes nothing."""

    def __init__(self, surface: Surface, path: Path, tried: Stamp | None) -> None:
        """`tried` is the stamp of the file before the model of the surface was loaded from it."""
        self.surface = surface
        self.path = path
        self._tried = self._seen = tried
        self._waiting: ModelFile | None = None
        """A model that was refused because the samples of its beam, or of its channels, do not arrive yet."""

    async def poll(self, stamp: Stamp | None) -> None:
        """Load the file, which has this stamp now, if the last poll has seen the same new one.

        A model that waits for its samples is used once they arrive. Raises nothing: the log and `surface.model_error`
        say why a file was refused.
        """
        seen, self._seen = self._seen, stamp
        try:
            if stamp is not None and stamp == seen and stamp != self._tried:
                self._tried, self._waiting = stamp, None
                # In a thread, because requests go on meanwhile.
                self._adopt(await asyncio.to_thread(load, self.path))
            elif self._waiting is not None and not self.find_mismatch(self._waiting):
                self._adopt(self._waiting)
        except ModelFileError as error:
            self._refuse(error)

    def _adopt(self, model: ModelFile) -> None:
        """Use a model from the next sample on.

        Raises ModelFileError if the samples are not those of the model, which then waits for them, or if the beam of
        the model does not have the zones of the surface.
        """
        old, self._waiting = self.surface.model, None
        if old is None or old.identity != model.identity:
            if mismatch := self.find_mismatch(model):
                self._waiting = model
                raise ModelFileError(f"{self.path}: {mismatch}")
            if conflict := self.zone_conflict(model):
                raise ModelFileError(f"{self.path}: {conflict}")
            self.surface.adopt(model)
            former = old.identity if old else "none"
            _log.info("surface %s: model %s instead of %s", self.surface.name, model.identity, former)
        self.surface.model_error = None

    def _refuse(self, error: ModelFileError) -> None:
        if self.surface.model is None:
            self.surface.model_error = str(error)
            _log.error("surface %s: no contact until its model file can be used: %s", self.surface.name, error)
            return
        self.surface.model_error = f"the old model stays in use: {error}"
        _log.error("surface %s: the new model cannot be used, the old one stays in use: %s", self.surface.name, error)

    def zone_conflict(self, model: ModelFile) -> str:
        """Return the first zone of the surface that a model cannot answer for, and why; empty if there is none."""
        return find_zone_conflict(self.surface.section, model)

    def find_mismatch(self, model: ModelFile) -> str:
        """Return why a model does not fit the samples that arrive; empty if it does.

        If they state no beam, it must be of the same beam as the model in use.
        """
        old, new_beam, kind = self.surface.model, model.metadata.beam, model.metadata.outline.kind
        beam = self.surface.sender_beam or (old.metadata.beam if old else None)
        if beam not in {None, new_beam}:
            whose = "the samples are" if self.surface.sender_beam else "the model in use is"
            other = "beam" if kind == "beam" else "structure"
            return (
                f"it is of {kind} {new_beam}, {whose} of {other} {beam}; to switch to another {other}, give the daemon "
                "the configuration that was built with this model, and restart it"
            )
        offered = self.surface.offered
        missing = [name for name in model.channels if offered is not None and name not in offered]
        if missing:
            return f"it needs {', '.join(missing)}, but the samples of this surface lack them"
        return ""


class Keeper(Protocol):
    """Keeps something in step with a file."""

    path: Path

    async def poll(self, stamp: Stamp | None) -> None:
        """Look at the file, which has this stamp now; None: it is not there."""


async def watch(keepers: Sequence[Keeper]) -> None:
    """Look at the files until cancelled, and load one after another."""
    while True:
        await asyncio.sleep(POLL_S)
        # In a thread, because a file system over a network may not answer.
        stamps = await asyncio.to_thread(lambda: [stamp_of(keeper.path) for keeper in keepers])
        for keeper, stamp in zip(keepers, stamps, strict=True):
            await keeper.poll(stamp)


def stamp_of(path: Path) -> Stamp | None:
    """Return the stamp of a file; None if there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino
