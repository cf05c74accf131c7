"""What tests of a model file that is replaced do again and again."""

import os
import time
from pathlib import Path

from beamtouch_models.metadata import POSITION_OUTPUTS
from beamtouch_service.host.models import ModelKeeper

NO_FORCE = (*POSITION_OUTPUTS,)
"""Outputs of a model that states no force."""


def put(path: Path, content: bytes, age_s: float = 10.0) -> None:
    """Put content there as a copy that was complete so long ago."""
    path.write_bytes(content)
    os.utime(path, (time.time() - age_s,) * 2)


def identity(keeper: ModelKeeper) -> str:
    assert keeper.surface.model is not None
    return keeper.surface.model.identity


async def polls(keeper: ModelKeeper, times: int = 3) -> None:
    for _ in range(times):
        await keeper.poll()
