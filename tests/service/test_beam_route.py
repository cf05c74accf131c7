"""`GET /surfaces/NAME/beam`: the drawing of the beam, by the model in use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beamtouch_models import modelfile
from beamtouch_service.api.surfaces import Beam
from beamtouch_service.surfaces.surface import Surface
from service.conftest import kind

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import Bench, BuildModel, MakeBatch


def test_it_is_that_of_the_model_in_use(
    make_bench: type[Bench], bench_model: Path, build_model: BuildModel, make_batch: MakeBatch
) -> None:
    surface = Surface("press-7", modelfile.load(build_model()))
    served = make_bench(surface)
    first = Beam.model_validate(served.get("/surfaces/press-7/beam").json())
    assert surface.model is not None
    assert (first.model, first.drawn) == (surface.model.identity, surface.model.metadata.drawn)

    surface.adopt(modelfile.load(bench_model))
    second = served.get("/surfaces/press-7/beam").json()
    assert second["length_mm"] == 400.0
    roller = {"kind": "simple", "slides": True}
    assert second["drawn"]["supports"] == [{"at_mm": 0.0, **roller}, {"at_mm": 400.0, **roller}]
    served.post(make_batch([0.0, 0.0, 0.0, 0.0]))
    assert served.get("/contact").json()["model"] == second["model"] != first.model


def test_without_a_model_or_a_surface_there_is_none(make_bench: type[Bench]) -> None:
    served = make_bench(Surface("press-7"))
    assert kind(served.get("/surfaces/press-7/beam")) == "no-model"
    assert kind(served.get("/surfaces/press-8/beam")) == "unknown-surface"
