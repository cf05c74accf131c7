"""Samples of another beam than that of the model: refused from the first one on, and every answer says so."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from beamtouch_service.api.stream import Pace
from beamtouch_service.outputs.modbus.blocks import Blocks
from service.conftest import kind

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch

DETAIL = (
    "The samples are of beam beam-2, the model is of beam beam-1. Give the service the model of beam-2, or the daemon "
    "the configuration that was built with this model (400 mm; s1 100, s2 200, s3 300)."
)


def test_every_answer_says_that_the_model_is_of_another_beam(
    bench: Bench, make_batch: MakeBatch, caplog: pytest.LogCaptureFixture
) -> None:
    refused = [bench.post(make_batch(sequence=sequence) | {"beam": "beam-2"}) for sequence in (1, 2)]
    assert [kind(answer) for answer in refused] == ["other-beam"] * 2
    assert [answer.status_code for answer in refused] == [503] * 2
    contact = bench.get("/contact")
    assert (contact.status_code, kind(contact), contact.json()["detail"]) == (503, "other-beam", DETAIL)
    assert [contact.json()[name] for name in ("sender_beam", "model_beam")] == ["beam-2", "beam-1"]
    assert bench.get("/health/ready").json()["surfaces"]["press-7"] == contact.json()
    summary = bench.get("/surfaces/press-7").json()
    assert (summary["beam"], summary["state"], summary["problem"]) == ("beam-1", None, contact.json())
    assert Blocks(bench.app.context.registry, "big").read(2, 1, bench.now_s) == [21]
    assert f"surface press-7: its samples are refused: {DETAIL}" in [one.getMessage() for one in caplog.records]
    assert len(caplog.records) == 1  # a line a minute


def test_samples_of_the_beam_of_the_model_or_of_none_are_taken(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch(boot_id="boot-0002") | {"beam": "beam-2"})
    assert bench.post(make_batch() | {"beam": "beam-1"}).status_code == 200
    assert bench.get("/contact").json()["state"] == "contact"
    assert bench.post(make_batch(sequence=2)).status_code == 200
    assert bench.get("/surfaces/press-7").json()["problem"] is None


def test_late_samples_of_a_former_beam_are_refused_and_change_no_answer(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch() | {"beam": "beam-1"})
    late = bench.post(make_batch(boot_id="boot-0000", age_ms=60_000) | {"beam": "beam-2"})
    assert kind(late) == "other-beam"
    assert bench.get("/contact").json()["state"] == "contact"
    bench.now_s += 1
    assert kind(bench.get("/contact")) == "stale"


def test_once_the_other_daemon_is_gone_samples_are_what_is_missing(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch() | {"beam": "beam-2"})
    bench.now_s += 9
    assert kind(bench.get("/contact")) == "other-beam"  # a daemon that is refused asks again within seconds
    bench.now_s += 2
    assert kind(bench.get("/contact")) == "no-samples"


@pytest.mark.parametrize("beam", ["", "beam 2", "x" * 65, 7])
def test_what_is_no_identity_is_refused(bench: Bench, make_batch: MakeBatch, beam: object) -> None:
    assert kind(bench.post(make_batch() | {"beam": beam})) == "invalid-request"


def test_the_stream_says_it_and_shows_no_deflection_as_current(bench: Bench, make_batch: MakeBatch) -> None:
    bench.post(make_batch() | {"beam": "beam-1"})
    bench.now_s += 1
    bench.post(make_batch(boot_id="boot-0002") | {"beam": "beam-2"})
    (surface,) = bench.app.context.registry
    state = json.loads(str(Pace().next(surface, bench.now_s)))
    assert state["problem"]["type"] == "urn:beamtouch:problem:other-beam"
    assert {channel["deflection_mm"] for channel in state["channels"]} == {None}
