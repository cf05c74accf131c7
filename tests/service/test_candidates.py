"""The candidate that a running service compares: when it is, and what is said of one that is not."""

from pathlib import Path

import pytest

from beamtouch_service import cli
from beamtouch_service.host import models
from beamtouch_service.host.candidates import CandidateKeeper
from beamtouch_service.host.models import ModelKeeper
from beamtouch_service.problems import ProblemError
from service.bench import parsed, surface_with
from service.event_story import RESTING, TOUCHING
from service.staged_files import BAD, NEW, NEWER, OLD, OTHER_BEAM, Files
from support.programs.in_process import command_of
from support.surfaces.small_model import content_of, model_of


@pytest.fixture
def files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Files:
    return Files(tmp_path, command_of(cli.main, capsys))


class Kept(CandidateKeeper):
    """The keeper of the candidate of a surface."""

    def __init__(self, files: Files) -> None:
        self.surface = surface_with(models.load(files.model))
        self.of_model = ModelKeeper(self.surface, files.model, models.stamp_of(files.model))
        super().__init__(self.of_model)

    async def polls(self, content: bytes | None = None, times: int = 3) -> None:
        if content is not None:
            self.path.write_bytes(content)
        for _ in range(times):
            await self.of_model.poll(models.stamp_of(self.of_model.path))
            await self.poll(models.stamp_of(self.path))

    @property
    def compared(self) -> str | None:
        shadow = self.surface.shadow
        return shadow.model.identity.partition("@")[0] if shadow else None

    @property
    def state(self) -> list[str | None]:
        """Name of the candidate that is compared, and why none is."""
        return [self.compared, self.surface.candidate_error]


@pytest.fixture
def kept(files: Files) -> Kept:
    return Kept(files)


@pytest.mark.anyio
async def test_a_candidate_is_compared_until_it_is_gone(kept: Kept) -> None:
    await kept.polls()
    assert kept.state == [None, None]
    await kept.polls(NEW, times=1)
    assert kept.compared is None
    await kept.polls()
    shadow = kept.surface.shadow
    assert kept.state == ["new", None]
    await kept.polls()
    assert kept.surface.shadow is shadow
    await kept.polls(NEWER)
    assert kept.compared == "newer"
    kept.path.unlink()
    await kept.polls(times=1)
    assert kept.state == [None, None]
    # It may come back as it was.
    await kept.polls(NEWER)
    assert kept.compared == "newer"


@pytest.mark.anyio
@pytest.mark.promise("docs/how-to/rollout.md", "The same file copied again begins nothing anew")
async def test_the_same_candidate_copied_again_is_compared_on(kept: Kept) -> None:
    """A timer may copy it every minute."""
    await kept.polls(NEW)
    shadow = kept.surface.shadow
    assert shadow
    kept.path.unlink()
    await kept.polls(NEW)
    assert kept.surface.shadow is shadow
    shadow.error = "it has ended"
    await kept.polls()
    assert kept.surface.shadow is shadow
    kept.path.unlink()
    await kept.polls(NEW)
    assert kept.compared == "new"
    assert kept.surface.shadow is not shadow


@pytest.mark.anyio
@pytest.mark.promise("docs/how-to/rollout.md", "A candidate that cannot be used changes nothing")
async def test_a_candidate_that_cannot_be_used_is_named_once(kept: Kept, caplog: pytest.LogCaptureFixture) -> None:
    reasons = {complaint: content for complaint, content in BAD.items() if content not in (OLD, OTHER_BEAM)} | {
        "it is the model in use": OLD,
        "it is of beam beam-2, the model in use is of beam beam-1": OTHER_BEAM,
        "it needs s4, s5, but the samples of this surface lack them": content_of("new", channels=5),
    }
    kept.surface.receive(parsed(RESTING), 10.0)
    for number, (complaint, content) in enumerate(reasons.items(), 1):
        await kept.polls(content, times=5)
        assert kept.compared is None
        assert complaint in str(kept.surface.candidate_error)
        assert complaint in caplog.messages[-1]
        assert len(caplog.messages) == number
        assert kept.surface.model_error is None


@pytest.mark.anyio
async def test_a_comparison_outlasts_samples_that_are_refused(kept: Kept) -> None:
    await kept.polls(NEW)
    kept.surface.receive(parsed(RESTING, TOUCHING, sequence=1), 10.0)
    with pytest.raises(ProblemError):
        kept.surface.receive(parsed(TOUCHING, sequence=3, channels=["s1", "s2", "t3"]), 10.1)
    await kept.polls()
    assert "it needs s3, but the samples of this surface lack them" in str(kept.surface.candidate_error)
    kept.surface.receive(parsed(TOUCHING, sequence=3), 10.2)
    await kept.polls()
    assert kept.surface.candidate_error is None
    assert kept.surface.shadow
    assert kept.surface.shadow.comparison.samples == 3


@pytest.mark.anyio
async def test_what_is_taken_is_in_use_and_compared_no_longer(kept: Kept, files: Files) -> None:
    await kept.polls(NEW)
    kept.surface.receive(parsed(TOUCHING), 10.0)
    files.take()
    await kept.polls()
    assert kept.surface.model
    assert kept.surface.model.identity == model_of("new").identity
    assert kept.compared is None
    files.take_back()
    await kept.polls()
    assert kept.surface.model.identity == model_of("old").identity
    assert kept.compared == "new"


@pytest.mark.anyio
async def test_another_model_begins_the_comparison_anew(kept: Kept, files: Files) -> None:
    await kept.polls(NEW)
    shadow = kept.surface.shadow
    files.model.write_bytes(NEWER)
    await kept.polls()
    assert kept.compared == "new"
    assert kept.surface.shadow is not shadow


@pytest.mark.anyio
async def test_without_a_model_in_use_there_is_nothing_to_compare(files: Files) -> None:
    surface = surface_with(None)
    surface.model_error = "damaged"
    keeper = CandidateKeeper(ModelKeeper(surface, files.model, None))
    files.candidate.write_bytes(NEW)
    for _ in range(3):
        await keeper.poll(models.stamp_of(keeper.path))
    assert "there is no model in use to compare it with" in str(surface.candidate_error)
