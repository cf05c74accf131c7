"""A model file that is looked at every second: when it is loaded, and when it is left alone."""

from __future__ import annotations

import asyncio
import os
import time
from typing import TYPE_CHECKING

import pytest

from beamtouch_service.problems import ProblemError
from service.kept_model import NO_FORCE, identity, polls, put

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from beamtouch_service.host.models import ModelKeeper
    from beamtouch_service.samples import Batch
    from service.conftest import BuildModel

    ParseBatch = Callable[..., Batch]

pytestmark = pytest.mark.anyio


async def test_a_file_is_loaded_when_two_looks_in_a_row_find_the_same_new_one(
    kept: ModelKeeper, build_model: BuildModel
) -> None:
    old = identity(kept)
    looks = []
    for content in (None, build_model(outputs=NO_FORCE).read_bytes(), None, None):
        if content:
            put(kept.path, content)
        await kept.poll()
        looks.append(identity(kept) != old)
    assert looks == [False, False, True, True]


async def test_a_bad_file_is_tried_once(kept: ModelKeeper, caplog: pytest.LogCaptureFixture) -> None:
    put(kept.path, b"hello")
    await polls(kept, 5)
    assert len(caplog.records) == 1


async def test_a_model_that_waits_for_its_channels_is_used_once_they_arrive(
    kept: ModelKeeper, build_model: BuildModel, parse_batch: ParseBatch, caplog: pytest.LogCaptureFixture
) -> None:
    old = identity(kept)
    kept.surface.receive(parse_batch(), arrival_s=10.0)
    put(kept.path, build_model(name="five", channels=5).read_bytes())
    await polls(kept)
    await polls(kept)
    kept.surface.receive(parse_batch([0.5] * 4, sequence=2), arrival_s=10.1)
    await polls(kept)
    assert (identity(kept), len(caplog.records)) == (old, 1)
    assert "it needs s4, s5" in str(kept.surface.model_error)

    kept.surface.receive(parse_batch([0.5] * 5, boot_id="boot-0002"), arrival_s=10.2)
    await polls(kept)
    assert identity(kept).startswith("five@")
    assert kept.surface.model_error is None


@pytest.mark.parametrize("model_comes_first", [True, False])
async def test_channels_that_are_renamed_are_refused_until_the_model_is_changed_too(
    kept: ModelKeeper, build_model: BuildModel, parse_batch: ParseBatch, *, model_comes_first: bool
) -> None:
    kept.surface.receive(parse_batch(), arrival_s=10.0)
    names = [f"t{number}" for number in range(1, 4)]
    renamed = parse_batch(channels=names, boot_id="boot-0002")
    content = build_model(name="renamed", prefix="t").read_bytes()

    async def change_model() -> None:
        put(kept.path, content)
        await polls(kept)

    if model_comes_first:
        await change_model()
    with pytest.raises(ProblemError):
        kept.surface.receive(renamed, arrival_s=10.1)
    if not model_comes_first:
        await change_model()
    await polls(kept)
    kept.surface.receive(renamed, arrival_s=10.2)
    assert kept.surface.contact(10.2).model.startswith("renamed@")


async def test_a_file_that_went_away_and_came_back_is_in_use_again(kept: ModelKeeper, tmp_path: Path) -> None:
    put(kept.path, kept.path.read_bytes())
    await polls(kept)
    kept.path.rename(tmp_path / "away")
    await polls(kept)
    assert kept.surface.model_error is None

    (tmp_path / "away").rename(kept.path)
    await polls(kept)
    assert kept.surface.model_error is None


async def test_what_is_no_file_is_never_opened(kept: ModelKeeper, caplog: pytest.LogCaptureFixture) -> None:
    kept.path.unlink()
    os.mkfifo(kept.path)
    os.utime(kept.path, (time.time() - 10,) * 2)
    try:
        async with asyncio.timeout(60):
            await polls(kept)
            await polls(kept)
    finally:
        # A thread that waits for a writer is let go, or the loop would wait for that thread.
        os.close(os.open(kept.path, os.O_RDWR | os.O_NONBLOCK))
    assert "not a regular file" in str(kept.surface.model_error)
    assert len(caplog.records) == 1
