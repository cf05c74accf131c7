"""Candidates: model files beside those in use, which run beside them on live samples until they are taken."""

import asyncio
import logging

from beamtouch_models.runtime import ModelFile, ModelFileError
from beamtouch_service.host.models import ModelKeeper, Stamp, load
from beamtouch_service.host.rollout import candidate_of
from beamtouch_service.surfaces.shadow import Shadow

_log = logging.getLogger(__name__)


class CandidateKeeper:
    """Keeps the shadow of a surface in step with the candidate's file. No candidate changes an answer."""

    def __init__(self, keeper: ModelKeeper) -> None:
        """Look for a candidate of this model."""
        self.path = candidate_of(keeper.path)
        self._keeper, self._surface = keeper, keeper.surface
        self._tried: Stamp | None = None
        self._seen: Stamp | None = None
        self._candidate: ModelFile | None = None
        """The newest file, if it can be used."""

    async def poll(self, stamp: Stamp | None) -> None:
        """Load the file, which has this stamp now, if the last poll has seen the same new one, and compare it.

        Raises nothing: the log and `surface.candidate_error` say why a file is not compared.
        """
        seen, self._seen = self._seen, stamp
        if stamp is None:
            self._tried = self._candidate = None
            self._refuse(None)
        elif stamp == seen and stamp != self._tried:
            self._tried, self._candidate = stamp, None
            try:
                # In a thread, because requests go on meanwhile.
                self._candidate = self._recognize(await asyncio.to_thread(load, self.path))
            except ModelFileError as error:
                self._refuse(str(error))
        if self._candidate:
            self._compare(self._candidate)

    def _compare(self, candidate: ModelFile) -> None:
        """Let a candidate run beside the model, unless it does already, or does not fit what is there now."""
        surface = self._surface
        is_known = surface.shadow is not None and surface.shadow.model is candidate
        if reason := self._find_obstacle(candidate):
            self._refuse(reason, ends=not is_known)  # samples that are refused now may be others soon
            return
        surface.candidate_error = None
        if not is_known:
            surface.shadow = Shadow(candidate, surface.name, surface.section)
            _log.info("surface %s: candidate %s runs beside the model", surface.name, candidate.identity)

    def _recognize(self, loaded: ModelFile) -> ModelFile:
        """Return the candidate that runs if this is the same: a tool may copy a file again and again.

        A comparison that has ended begins anew with another copy.
        """
        shadow = self._surface.shadow
        is_same = shadow and shadow.error is None and shadow.model.identity == loaded.identity
        return shadow.model if shadow and is_same else loaded

    def _find_obstacle(self, candidate: ModelFile) -> str:
        """Return why a candidate cannot be compared now; empty if it can."""
        model = self._surface.model
        if model is None:
            return f"{self.path}: there is no model in use to compare it with"
        if model.identity == candidate.identity:
            return f"{self.path}: it is the model in use"
        if reason := self._keeper.find_mismatch(candidate) or self._keeper.zone_conflict(candidate):
            return f"{self.path}: {reason}"
        if candidate.metadata.beam != model.metadata.beam:
            return f"{self.path}: it is of the beam whose samples arrive, the model in use is not"
        return ""

    def _refuse(self, reason: str | None, *, ends: bool = True) -> None:
        """Say why there is no comparison now, None if the file is gone; end one that is there, or let it wait."""
        surface = self._surface
        if reason is None and surface.shadow:
            _log.info("surface %s: candidate %s is gone", surface.name, surface.shadow.model.identity)
        if reason is not None and reason != surface.candidate_error:
            _log.warning("surface %s: the candidate is not compared: %s", surface.name, reason)
        surface.candidate_error = reason
        if ends:
            surface.shadow = None
