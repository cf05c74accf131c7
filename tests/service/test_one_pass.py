"""A batch in one pass: one run of the graph for all of it, whatever the batch before was."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beamtouch_models import modelfile
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.surface import Surface

if TYPE_CHECKING:
    from service.conftest import BuildModel, MakeBatch

MOVING = [1.0, 0.2, 1.0, 0.2, 0.2, 1.0]
"""Covariance far beyond the noise: the sample is also weighed as if it were still."""


def moving(make_batch: MakeBatch, samples: int, sequence: int, **more: object) -> Batch:
    made = make_batch(*[[0.5, 0.25, 0.125]] * samples, sequence=sequence)
    for sample in made["samples"][1:]:
        sample |= {"readings": 4, "covariance_mm2": MOVING}
    return Batch.model_validate(made | more)


def test_the_graph_runs_once_for_a_batch_whose_readings_move(build_model: BuildModel, make_batch: MakeBatch) -> None:
    surface, runs = Surface("press-7", modelfile.load(build_model())), list[float]()
    surface.on_run = runs.append
    for number, samples in enumerate((4, 1, 2, 16, 4), start=1):
        surface.receive(moving(make_batch, samples, 100 * number), 10.0 + number)
        assert len(runs) == number


def test_samples_get_the_same_figures_in_a_batch_of_any_size(build_model: BuildModel, make_batch: MakeBatch) -> None:
    model, samples = modelfile.load(build_model()), 2 * 16 + 3
    whole, found = moving(make_batch, samples, 1), list[Contact]()
    for size in (1, 4, 16, samples):
        surface = Surface("press-7", model)
        for start in range(0, samples, size):
            part = whole.model_copy(update={"samples": whole.samples[start : start + size]})
            surface.receive(part, 10.0)
        found.append(surface.contact(10.0))
    assert all(one == found[0] for one in found)


def test_a_batch_with_other_channels_or_noise_is_weighed_anew(build_model: BuildModel, make_batch: MakeBatch) -> None:
    surface = Surface("press-7", modelfile.load(build_model()))
    surface.receive(moving(make_batch, 1, 1), 10.0)
    assert surface.contact(10.0).notes == []
    surface.receive(moving(make_batch, 1, 2, noise_mm=[0.05] * 3), 10.0)
    assert surface.contact(10.0).notes == ["noise"]
    surface.receive(moving(make_batch, 1, 3, channels=["s3", "s2", "s1"]), 10.0)
    # Now s1 is 0.125 mm, and s3 is 0.5 mm: the model knows no such contact.
    contact = surface.contact(10.0)
    assert (contact.notes, contact.misfit) == (["unsteady"], 250.0)
