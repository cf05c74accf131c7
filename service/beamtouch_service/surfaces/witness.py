"""Interface for observers of a surface's decisions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from beamtouch_models.modelfile import ModelFile
    from beamtouch_service.samples import Batch, Sample
    from beamtouch_service.surfaces.served_model import ServedModel
    from beamtouch_service.surfaces.surface import Surface
    from beamtouch_service.surfaces.touch import Seen


class Witness(Protocol):
    """Receives the decisions of a surface."""

    def fresh(self, surface: Surface, model: ModelFile, boot_id: str, seen: list[Seen]) -> None:
        """Note samples that moved the answer, in order."""

    def stale(self, surface: Surface) -> None:
        """Note that the newest sample of a surface has become too old."""

    def late(self, surface: Surface, served: ServedModel, batch: Batch, samples: list[Sample]) -> None:
        """Note samples of a batch that came after newer ones, in order."""

    def has_room(self, samples: int) -> bool:
        """Say whether this many late samples can be noted now."""
