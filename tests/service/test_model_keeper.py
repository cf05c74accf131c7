"""New models while the service runs: in at once if they are good, and nothing changes if they are not."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

import onnx
import pytest

from beamtouch_service.problems import ProblemError
from beamtouch_service.surfaces.surface import Surface
from service.kept_model import NO_FORCE, identity, polls, put

if TYPE_CHECKING:
    from collections.abc import Callable

    from beamtouch_service.host.models import ModelKeeper
    from beamtouch_service.samples import Batch
    from service.conftest import Bench, BuildModel, MakeBatch

    ParseBatch = Callable[..., Batch]

pytestmark = pytest.mark.anyio


async def test_a_new_model_answers_from_the_next_sample_on(
    kept: ModelKeeper, build_model: BuildModel, parse_batch: ParseBatch
) -> None:
    old = identity(kept)
    kept.surface.receive(parse_batch(), arrival_s=10.0)
    put(kept.path, build_model(outputs=NO_FORCE).read_bytes())

    await polls(kept)
    assert identity(kept) != old
    assert (kept.surface.contact(10.0).model, kept.surface.contact(10.0).force_n) == (old, 8.75)
    kept.surface.receive(parse_batch(sequence=2), arrival_s=10.1)
    assert (kept.surface.contact(10.1).model, kept.surface.contact(10.1).force_n) == (identity(kept), None)


async def test_others_go_on_while_a_model_is_loaded(kept: ModelKeeper, build_model: BuildModel) -> None:
    old = identity(kept)
    put(kept.path, build_model(outputs=NO_FORCE).read_bytes())
    await kept.poll()  # sees it first
    loading, turns = asyncio.ensure_future(kept.poll()), 0
    while not loading.done():
        await asyncio.sleep(0)
        turns += 1
    assert identity(kept) != old
    assert turns > 1


async def test_the_same_content_is_no_new_model(kept: ModelKeeper) -> None:
    put(kept.path, kept.path.read_bytes())
    old = kept.surface.model

    await polls(kept)
    assert kept.surface.model is old
    assert kept.surface.model_error is None


async def test_a_bad_file_changes_nothing_and_is_named_until_there_is_a_good_one(
    kept: ModelKeeper, build_model: BuildModel, caplog: pytest.LogCaptureFixture
) -> None:
    old, good = kept.surface.model, kept.path.read_bytes()
    other = build_model(name="tool").read_bytes()
    wrong_answers = onnx.load_from_string(good)
    for entry in wrong_answers.metadata_props:
        if entry.key == "beamtouch.golden":
            entry.value = entry.value.replace("103.", "104.").replace("130.", "131.").replace("100.0", "101.0")
    bad = {
        "damaged": good[: len(good) // 2],
        "not an ONNX file": b"hello",
        "golden answers": wrong_answers.SerializeToString(),
        **{
            f"lacks {name})": build_model(outputs=tuple(one for one in NO_FORCE if one != name)).read_bytes()
            for name in NO_FORCE[1:]
        },
    }
    for complaint, content in bad.items():
        put(kept.path, content)
        await polls(kept)
        assert kept.surface.model is old
        assert complaint in str(kept.surface.model_error)
        assert complaint in caplog.records[-1].getMessage()
    kept.path.unlink()
    await polls(kept)
    assert kept.surface.model is old

    put(kept.path, good)
    await polls(kept)
    assert (kept.surface.model, kept.surface.model_error) == (old, None)
    put(kept.path, other)
    await polls(kept)
    assert identity(kept).startswith("tool@")


async def test_a_model_for_channels_that_do_not_arrive_is_refused(
    kept: ModelKeeper, build_model: BuildModel, parse_batch: ParseBatch
) -> None:
    kept.surface.receive(parse_batch(), arrival_s=10.0)
    put(kept.path, build_model(channels=5).read_bytes())

    await polls(kept)
    assert "it needs s4, s5, but the samples of this surface lack them" in str(kept.surface.model_error)
    assert kept.surface.contact(10.0).position_mm == 150.0


@pytest.mark.parametrize(("stated", "whose"), [(None, "the model in use is"), ("beam-1", "the samples are")])
async def test_a_model_of_another_beam_waits_for_samples_of_that_beam(
    kept: ModelKeeper,
    build_model: BuildModel,
    parse_batch: ParseBatch,
    stated: str | None,
    whose: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    old = identity(kept)
    kept.surface.receive(parse_batch().model_copy(update={"beam": stated}), arrival_s=10.0)
    put(kept.path, build_model(beam="beam-2", outputs=NO_FORCE).read_bytes())
    await polls(kept, 5)
    assert identity(kept) == old
    assert f"it is of beam beam-2, {whose} of beam beam-1; to switch to another" in str(kept.surface.model_error)
    assert len(caplog.records) == 1

    other = parse_batch(boot_id="boot-0002").model_copy(update={"beam": "beam-2"})
    with pytest.raises(ProblemError):
        kept.surface.receive(other, arrival_s=10.1)
    await polls(kept)
    assert (identity(kept) != old, kept.surface.model_error) == (True, None)
    kept.surface.receive(other, arrival_s=10.2)
    assert kept.surface.contact(10.2).model == identity(kept)


async def test_a_copy_under_way_is_waited_for(kept: ModelKeeper, build_model: BuildModel) -> None:
    old, new = identity(kept), build_model(outputs=NO_FORCE).read_bytes()
    with kept.path.open("wb") as file:
        for begin in range(0, len(new), len(new) // 8 + 1):
            file.write(new[begin : begin + len(new) // 8 + 1])
            file.flush()
            await kept.poll()
            assert (identity(kept), kept.surface.model_error) == (old, None)
    await kept.poll()
    assert identity(kept) != old
    assert kept.surface.model_error is None


async def test_the_routes_of_a_model(
    make_bench: type[Bench], kept: ModelKeeper, build_model: BuildModel, make_batch: MakeBatch
) -> None:
    bench = make_bench(kept.surface, Surface("bare"))
    said = bench.get("/surfaces/press-7/model").json()
    assert (said["identity"], said["channels"]) == (identity(kept), ["s1", "s2", "s3"])
    assert said["positions_mm"] == [100.0, 200.0, 300.0]
    assert said["ranges"] == {"position_mm": [1.0, 399.0], "force_n": [1.0, 20.0]}
    assert said["accuracy"]["limit_percent"] == 1.0
    assert bench.get("/surfaces/bare/model").json()["type"] == "urn:beamtouch:problem:no-model"

    put(kept.path, build_model(outputs=NO_FORCE).read_bytes())
    await polls(kept)
    assert bench.get("/surfaces/press-7/model").json()["identity"] == identity(kept) != said["identity"]
    put(kept.path, b"hello")
    await polls(kept)
    assert "damaged" in bench.get("/surfaces/press-7").json()["model_error"]
    assert bench.post(make_batch()).status_code == 200
    assert bench.get("/contact?surface=press-7").json()["model"] == identity(kept)
