"""Whether the samples of a surface belong to the service's model, and what a check says if they do not."""

import pytest

from beamtouch_daemon.delivery.readiness import Readiness, _compare, _Summary

from .surfaces import surface_of

NAMED = surface_of(3, beam="beam-1")
UNNAMED = surface_of(3)


@pytest.mark.parametrize("summary", [_Summary(channels=["s3", "s1"], beam="beam-1"), _Summary(channels=[], beam=None)])
def test_a_model_of_the_stated_beam_takes_the_samples(summary: _Summary) -> None:
    assert _compare(summary, "bench", NAMED) == Readiness()


def test_a_surface_that_states_no_beam_is_taken_if_the_model_has_none() -> None:
    assert _compare(_Summary(channels=["s1"]), "bench", UNNAMED) == Readiness()


def test_a_model_of_another_beam_is_refused_before_its_channels_are_looked_at() -> None:
    readiness = _compare(_Summary(channels=["s9"], beam="beam-2"), "bench", NAMED)
    assert readiness == Readiness(
        "the service's model is of beam beam-2, but surfaces.bench.beam is beam-1: give the service the model of "
        "beam-1, or use the configuration that was built with its model"
    )


def test_channels_that_the_model_needs_and_the_configuration_lacks_are_named() -> None:
    readiness = _compare(_Summary(channels=["s1", "s4", "s7"], beam="beam-1"), "bench", NAMED)
    assert readiness == Readiness("the service's model needs channels s1, s4, s7; s4, s7 not in the configuration")


def test_a_surface_that_states_no_beam_is_told_what_to_write() -> None:
    readiness = _compare(_Summary(channels=["s1"], model="0f3a", beam="beam-2"), "bench", UNNAMED)
    assert readiness == Readiness(
        doubt="surfaces.bench states no beam, so a model of another beam would pass unnoticed; if the service's model "
        '0f3a is the right one, write beam = "beam-2"'
    )
