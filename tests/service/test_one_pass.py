"""A batch in one pass: one run of the graph for all of it, and the arrangement of the batch before."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beamtouch_models import modelfile
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.served_model import MAX_BOUND, ServedModel
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.timings import Timings

if TYPE_CHECKING:
    from service.conftest import BuildModel, MakeBatch

MOVING = [1.0, 0.2, 1.0, 0.2, 0.2, 1.0]
"""Covariance far beyond the noise: the sample is also weighed as if it were still."""


class Runs(list[float]):
    """Takes the durations of estimates."""

    def observe(self, amount: float) -> None:
        self.append(amount)


def moving(make_batch: MakeBatch, samples: int, sequence: int, **more: object) -> Batch:
    made = make_batch(*[[0.5, 0.25, 0.125]] * samples, sequence=sequence)
    for sample in made["samples"][1:]:
        sample |= {"readings": 4, "covariance_mm2": MOVING}
    return Batch.model_validate(made | more)


def test_the_graph_runs_once_for_a_batch_whose_readings_move(build_model: BuildModel, make_batch: MakeBatch) -> None:
    surface, runs = Surface("press-7", modelfile.load(build_model())), Runs()
    surface.timings = Timings(inference_s=runs)
    for number, samples in enumerate((4, 1, 2, MAX_BOUND, 4), start=1):
        surface.receive(moving(make_batch, samples, 100 * number), 10.0 + number)
        assert len(runs) == number


def test_samples_get_the_same_figures_in_a_batch_of_any_size(build_model: BuildModel, make_batch: MakeBatch) -> None:
    model, samples = modelfile.load(build_model()), 2 * MAX_BOUND + 3
    whole, found = moving(make_batch, samples, 1), list[Contact]()
    for size in (1, 4, MAX_BOUND, samples):
        surface = Surface("press-7", model)
        for start in range(0, samples, size):
            part = whole.model_copy(update={"samples": whole.samples[start : start + size]})
            surface.receive(part, 10.0)
        found.append(surface.contact(10.0))
    assert all(one == found[0] for one in found)


def test_a_batch_with_other_channels_or_noise_is_arranged_anew(build_model: BuildModel, make_batch: MakeBatch) -> None:
    served = ServedModel(modelfile.load(build_model()))
    first = served.arrangement(moving(make_batch, 1, 1))
    assert served.arrangement(moving(make_batch, 3, 2)) is first
    noisy = served.arrangement(moving(make_batch, 1, 5, noise_mm=[0.05] * 3))
    assert noisy is not first
    assert noisy.contradicts
    turned = served.arrangement(moving(make_batch, 1, 6, channels=["s3", "s1", "s2"]))
    weighed, _ = turned.weighed(moving(make_batch, 1, 6).samples)
    assert weighed.deflection_mm.tolist() == [[0.25, 0.125, 0.5]]
