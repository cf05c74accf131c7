"""Thresholds by the number of channels that took part in a sample, not by that of the model."""

import numpy as np
import pytest

from beamtouch_models.runtime import (
    Evidence,
    Hypotheses,
    Memory,
    ModelFile,
    State,
    Suspects,
    Weighed,
    evidence,
    is_odd,
)
from support.surfaces.deflections import deflections_of

JUST = 1.01
NEVER = 1e9


def sample_of(model: ModelFile, channels: int, deflection_mm: list[float] | None = None) -> Weighed:
    """Return a sample in which only the first `channels` took part."""
    count = len(model.channels)
    valid = np.arange(count)[None] < channels
    values = np.array([deflection_mm]) if deflection_mm else deflections_of(model, [200.0], [5.0])
    noise_mm2 = np.full((1, count), model.metadata.noise.sample_mm**2)
    return Weighed(np.where(valid, values, 0.0), np.eye(count)[None] * noise_mm2[:, None], noise_mm2, valid)


def said_of(model: ModelFile, channels: int) -> Evidence:
    (said,) = evidence(model.metadata, model.run, sample_of(model, channels))
    assert said.channels == channels
    return said


def with_answer(said: Evidence, **answers: float) -> Evidence:
    return said._replace(answer=said.answer | answers)


def numbers(model: ModelFile) -> range:
    """Return the numbers of channels; their thresholds differ."""
    thresholds = model.metadata.thresholds
    for each in (thresholds.touch, thresholds.rest, thresholds.misfit):
        assert len(set(each)) > 2
    return range(1, len(model.channels) + 1)


def test_the_misfit_of_a_contact_is_judged_by_the_channels_of_the_sample(bench: ModelFile) -> None:
    thresholds = bench.metadata.thresholds
    for channels in numbers(bench):
        said, limit = said_of(bench, channels)._replace(rest_misfit=NEVER), thresholds.misfit[channels - 1]
        assert is_odd(thresholds, with_answer(said, misfit=limit * JUST)), channels
        assert not is_odd(thresholds, with_answer(said, misfit=limit / JUST)), channels


def test_rest_is_judged_by_the_channels_of_the_sample(bench: ModelFile) -> None:
    thresholds = bench.metadata.thresholds
    for channels in numbers(bench):
        said, limit = with_answer(said_of(bench, channels), misfit=NEVER), thresholds.rest[channels - 1]
        assert is_odd(thresholds, said._replace(rest_misfit=limit * JUST)), channels
        assert not is_odd(thresholds, said._replace(rest_misfit=limit / JUST)), channels


@pytest.mark.promise("docs/reference/contact.md", "exceed the threshold for the number of working channels")
def test_a_touch_is_judged_by_the_channels_of_the_sample(bench: ModelFile) -> None:
    thresholds = bench.metadata.thresholds
    for channels in numbers(bench):
        said, limit = with_answer(said_of(bench, channels), misfit=0.0), thresholds.touch[channels - 1]
        for odds, state in ((limit * JUST, State.CONTACT), (limit / JUST, State.CLEAR)):
            decider = Hypotheses(thresholds, [Memory(State.CLEAR, armed=True)])
            touched = with_answer(said, contact_log_odds=odds)._replace(still_log_odds=odds, moves=False)
            assert decider.step(touched).state is state, channels


@pytest.mark.promise(
    "docs/reference/contact.md",
    (
        "`check-NAME` needs four working channels: without the named one, three must be left, because two explain "
        "nearly any load."
    ),
)
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_with_so_few_channels_none_is_suspected(bench: ModelFile, channels: int) -> None:
    """Two that are left fit most contacts: one that contradicts them is as likely right."""
    load = deflections_of(bench, [100.0], [8.0])[0]
    load[channels - 1] = -0.3
    suspects = Suspects(bench.metadata, bench.run)
    for _ in range(60):
        (without,) = suspects.leave_out(sample_of(bench, channels, load.tolist()))
        assert without == {}
        suspects.add(without)
    assert suspects.suspect is None


def test_with_four_channels_the_one_that_contradicts_is_suspected(bench: ModelFile) -> None:
    load = deflections_of(bench, [100.0], [8.0])[0]
    load[2] = -0.3
    suspects = Suspects(bench.metadata, bench.run)
    for _ in range(60):
        suspects.add(*suspects.leave_out(sample_of(bench, 4, load.tolist())))
    assert suspects.suspect == bench.channels[2]
