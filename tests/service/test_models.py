"""New model files while the service runs: in use at once if they are good, and nothing changes if they are not."""

import asyncio
import os
import time
from pathlib import Path

import onnx
import pytest

from beamtouch_common.zones import Zone
from beamtouch_models.runtime.metadata import POSITION_OUTPUTS
from beamtouch_service.host import models
from beamtouch_service.host.models import ModelKeeper
from beamtouch_service.problems import ProblemError
from beamtouch_service.sections import SurfaceSection
from service.bench import Bench, parsed, surface_with
from support.surfaces.small_model import content_of, write_model

pytestmark = pytest.mark.anyio
NO_FORCE = content_of(outputs=POSITION_OUTPUTS)


class Kept(ModelKeeper):
    """The keeper of the model of one surface `press-7`, and of its file."""

    def __init__(self, path: Path, section: SurfaceSection | None = None) -> None:
        super().__init__(surface_with(models.load(path), section=section), path, models.stamp_of(path))

    @property
    def identity(self) -> str:
        assert self.surface.model is not None
        return self.surface.model.identity

    def put(self, content: bytes) -> None:
        """Put content there as a copy that was complete 10 s ago."""
        self.path.write_bytes(content)
        os.utime(self.path, (time.time() - 10,) * 2)

    async def polls(self, content: bytes | None = None, times: int = 3) -> None:
        if content is not None:
            self.put(content)
        for _ in range(times):
            await self.look()

    async def look(self) -> None:
        await self.poll(models.stamp_of(self.path))


@pytest.fixture
def kept(tmp_path: Path) -> Kept:
    return Kept(write_model(tmp_path))


@pytest.mark.promise("docs/how-to/upgrade.md", "A running service takes a new model file within a few seconds")
async def test_a_new_model_is_in_use_after_two_looks_that_find_the_same_file(kept: Kept) -> None:
    bench, old, looks = Bench(kept.surface), kept.identity, []
    bench.send()
    kept.put(NO_FORCE)
    for _ in range(3):
        await kept.look()
        looks.append(kept.identity != old)
    assert looks == [False, True, True]
    assert (bench.contact()["model"], bench.contact()["force_n"]) == (old, 8.75)
    bench.send(sequence=2)
    assert (bench.contact()["model"], bench.contact()["force_n"]) == (kept.identity, None)
    assert bench.get("/surfaces/press-7/model").json()["identity"] == kept.identity
    # The same content is no new model.
    model = kept.surface.model
    await kept.polls(NO_FORCE)
    assert (kept.surface.model is model, kept.surface.model_error) == (True, None)


async def test_others_go_on_while_a_model_is_loaded(kept: Kept) -> None:
    old = kept.identity
    await kept.polls(NO_FORCE, times=1)  # sees it first
    loading, turns = asyncio.ensure_future(kept.look()), 0
    while not loading.done():
        await asyncio.sleep(0)
        turns += 1
    assert kept.identity != old
    assert turns > 1


async def test_a_copy_under_way_is_waited_for(kept: Kept) -> None:
    old = kept.identity
    with kept.path.open("wb") as file:
        for begin in range(0, len(NO_FORCE), len(NO_FORCE) // 8 + 1):
            file.write(NO_FORCE[begin : begin + len(NO_FORCE) // 8 + 1])
            file.flush()
            await kept.look()
            assert (kept.identity, kept.surface.model_error) == (old, None)
    await kept.look()
    assert (kept.identity != old, kept.surface.model_error) == (True, None)


@pytest.mark.promise(
    "docs/how-to/upgrade.md",
    "the graph gives the golden answers that the file holds",
    "Otherwise the old model stays, and the log and `model_error` of `GET /surfaces/NAME` say why.",
)
async def test_a_bad_file_changes_nothing_and_is_named_once_until_there_is_a_good_one(
    kept: Kept, caplog: pytest.LogCaptureFixture
) -> None:
    old, good = kept.surface.model, kept.path.read_bytes()
    wrong_answers = onnx.load_from_string(good)
    for entry in wrong_answers.metadata_props:
        if entry.key == "beamtouch.golden":
            entry.value = entry.value.replace("103.", "104.").replace("130.", "131.").replace("100.0", "101.0")
    bad = {
        "damaged": good[: len(good) // 2],
        "not an ONNX file": b"hello",
        "golden answers": wrong_answers.SerializeToString(),
        **{
            f"lacks {name})": content_of(outputs=tuple(one for one in POSITION_OUTPUTS if one != name))
            for name in POSITION_OUTPUTS[1:]
        },
    }
    for number, (complaint, content) in enumerate(bad.items(), start=1):
        await kept.polls(content, times=5)
        assert kept.surface.model is old
        assert complaint in str(kept.surface.model_error)
        assert complaint in caplog.messages[-1]
        assert len(caplog.messages) == number
    kept.path.unlink()
    await kept.polls()
    assert kept.surface.model is old
    await kept.polls(good)
    assert (kept.surface.model, kept.surface.model_error) == (old, None)
    kept.path.rename(kept.path.with_name("away"))
    await kept.polls()
    kept.path.with_name("away").rename(kept.path)
    await kept.polls()
    assert kept.surface.model_error is None


@pytest.mark.promise(
    "docs/how-to/upgrade.md",
    "the samples that arrive are of the beam of the file, and have its channels",
)
async def test_a_model_waits_for_its_channels(kept: Kept, caplog: pytest.LogCaptureFixture) -> None:
    old = kept.identity
    kept.surface.receive(parsed(), 10.0)
    await kept.polls(content_of("five", channels=5), times=6)
    kept.surface.receive(parsed([0.5] * 4, sequence=2), 10.1)
    await kept.polls()
    assert (kept.identity, len(caplog.records)) == (old, 1)
    assert "it needs s4, s5, but the samples of this surface lack them" in str(kept.surface.model_error)
    assert kept.surface.view(10.1).answered_by == old
    kept.surface.receive(parsed([0.5] * 5, boot_id="boot-0002"), 10.2)
    await kept.polls()
    assert (kept.identity[:5], kept.surface.model_error) == ("five@", None)


@pytest.mark.promise(
    "docs/how-to/upgrade.md",
    "give the service the new model and the daemon the configuration that was built with it, in either order",
)
@pytest.mark.parametrize("model_comes_first", [True, False])
async def test_model_and_daemon_may_be_changed_in_either_order(kept: Kept, *, model_comes_first: bool) -> None:
    kept.surface.receive(parsed(), 10.0)
    renamed = parsed(channels=["t1", "t2", "t3"], boot_id="boot-0002")
    content = content_of("renamed", prefix="t")
    if model_comes_first:
        await kept.polls(content)
    with pytest.raises(ProblemError):
        kept.surface.receive(renamed, 10.1)
    if not model_comes_first:
        await kept.polls(content)
    await kept.polls()
    kept.surface.receive(renamed, 10.2)
    assert str(kept.surface.view(10.2).answered_by).startswith("renamed@")


@pytest.mark.promise(
    "docs/how-to/upgrade.md",
    "the samples that arrive are of the beam of the file",
    "Samples that state no beam are taken with any model, so only a restart of the service changes the beam then",
)
@pytest.mark.parametrize(("stated", "whose"), [(None, "the model in use is"), ("beam-1", "the samples are")])
async def test_a_model_of_another_beam_waits_for_samples_of_that_beam(
    kept: Kept, stated: str | None, whose: str, caplog: pytest.LogCaptureFixture
) -> None:
    old = kept.identity
    kept.surface.receive(parsed().model_copy(update={"beam": stated}), 10.0)
    await kept.polls(content_of(beam="beam-2"), times=5)
    assert kept.identity == old
    assert f"it is of beam beam-2, {whose} of beam beam-1; to switch to another" in str(kept.surface.model_error)
    assert len(caplog.records) == 1
    other = parsed(boot_id="boot-0002").model_copy(update={"beam": "beam-2"})
    with pytest.raises(ProblemError):
        kept.surface.receive(other, 10.1)
    await kept.polls()
    assert (kept.identity != old, kept.surface.model_error) == (True, None)
    kept.surface.receive(other, 10.2)
    assert kept.surface.view(10.2).answered_by == kept.identity


@pytest.fixture
def zoned(tmp_path: Path) -> Kept:
    """Of a surface with a zone that has a bound of the force."""
    zone = Zone(from_mm=120, to_mm=200, least_force_n=5)
    return Kept(write_model(tmp_path), SurfaceSection(zones={"gate": zone}))


@pytest.mark.promise("docs/how-to/upgrade.md", "the zones of the surface lie on that beam")
async def test_a_new_model_that_a_zone_is_off_leaves_the_old_one_in_use(zoned: Kept) -> None:
    old = zoned.identity
    await zoned.polls(NO_FORCE)
    assert zoned.identity == old
    assert f"{zoned.path}: gate: a bound of the force needs a scene" in str(zoned.surface.model_error)


async def test_a_model_whose_samples_arrive_at_last_is_refused_once_for_a_zone(
    zoned: Kept, caplog: pytest.LogCaptureFixture
) -> None:
    old = zoned.identity
    zoned.surface.receive(parsed(), 10.0)
    await zoned.polls(content_of("five", channels=5, outputs=POSITION_OUTPUTS))
    assert "it needs s4, s5, but" in str(zoned.surface.model_error)
    zoned.surface.receive(parsed([0.5] * 5, boot_id="boot-0002"), 10.1)
    await zoned.polls()
    assert zoned.identity == old
    assert f"{zoned.path}: gate: a bound of the force needs a scene" in str(zoned.surface.model_error)
    assert len(caplog.records) == 2
