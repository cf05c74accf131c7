"""Interface for observers of a surface's decisions.

It takes the type of the surface as a parameter, because a surface holds its observer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:
    from beamtouch_models.modelfile import ModelFile
    from beamtouch_service.samples import Batch, Sample
    from beamtouch_service.surfaces.follower import Seen

S_contra = TypeVar("S_contra", contravariant=True)
"""The type of the surface."""


class Witness(Protocol[S_contra]):
    """Receives the decisions of a surface."""

    def fresh(self, surface: S_contra, model: ModelFile, boot_id: str, seen: list[Seen]) -> None:
        """Note samples that moved the answer, in order."""

    def stale(self, surface: S_contra) -> None:
        """Note that the newest sample of a surface has become too old."""

    def late(self, surface: S_contra, model: ModelFile, batch: Batch, samples: list[Sample]) -> None:
        """Note samples of a batch that came after newer ones, in order."""

    def has_room(self, samples: int) -> bool:
        """Say whether this many late samples can be noted now."""
