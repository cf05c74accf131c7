"""What a surface takes, answers and shows at one time, and which reason it gives if there are several."""

import json
from collections.abc import Collection
from typing import Any

import pytest

from beamtouch_models.runtime import State
from beamtouch_service.api.stream import state_of
from beamtouch_service.api.surfaces import summarize
from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.samples import Quality
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.channels import ChannelHealth, SurfaceHealth
from beamtouch_service.surfaces.fields import members_of
from beamtouch_service.surfaces.pace import Pace
from beamtouch_service.surfaces.registry import Registry
from beamtouch_service.surfaces.surface import Surface
from service.bench import parsed, surface_of, surface_with
from service.event_story import ODD, RESTING, TOUCHING
from support.surfaces.small_model import model_of

NOW_S = 1000.0
OTHER = {"beam": "beam-2"}


def told(surface: Surface, now_s: float = NOW_S) -> dict[str, Any]:
    """Return the state of a surface, as the first event of a stream has it."""
    state: dict[str, Any] = json.loads(json.dumps(state_of(surface.view(now_s))))
    return state


def shown(surface: Surface, now_s: float = NOW_S) -> list[tuple[float | None, str]]:
    """Return deflection and quality of each channel, as the stream has them."""
    channels = told(surface, now_s)["channels"]
    assert [(one["name"], one["position_mm"]) for one in channels] == [("s1", 100.0), ("s2", 200.0), ("s3", 300.0)]
    return [(one["deflection_mm"], one["quality"]) for one in channels]


NONE_SHOWN = [(None, "missing")] * 3


def test_deflections_are_shown_while_they_are_current_even_if_there_is_no_contact() -> None:
    surface = surface_of()
    assert shown(surface) == NONE_SHOWN
    surface.receive(parsed(TOUCHING), NOW_S)
    assert shown(surface) == [(0.5, "good"), (0.25, "good"), (0.125, "good")]
    assert shown(surface, NOW_S + 0.5) == shown(surface)
    assert shown(surface, NOW_S + 0.5001) == NONE_SHOWN  # stale
    surface.receive(parsed([0.5, None, None], sequence=2, quality=["good", "stuck", "missing"]), NOW_S)
    assert told(surface)["problem"] is not None
    assert shown(surface) == [(0.5, "good"), (None, "stuck"), (None, "missing")]


def test_deflections_of_another_beam_are_not_shown() -> None:
    surface = surface_of(section=SurfaceSection(stale_ms=100.0))
    surface.receive(parsed(TOUCHING), NOW_S - 0.2)
    refuse(surface, 2, NOW_S)
    assert surface.view(NOW_S).status is Kind.OTHER_BEAM
    assert shown(surface) == NONE_SHOWN


def test_a_state_has_the_contact_or_the_problem_with_the_scale_of_the_misfit() -> None:
    surface = surface_of()
    before = told(surface)
    assert (before["contact"], before["misfit_limit"], before["age_ms"], before["sequence"]) == (None, None, None, None)
    assert before["problem"]["type"].endswith("no-samples")
    surface.receive(parsed(TOUCHING, sequence=7, age_ms=12.34), NOW_S)
    state = told(surface, NOW_S + 0.1)
    assert (state["problem"], state["misfit_limit"], state["age_ms"], state["sequence"]) == (None, 30.0, 112.3, 7)
    contact = members_of(surface.view(NOW_S + 0.1))
    assert (state["contact"], state["length_mm"]) == (contact, 400.0)
    bare = told(surface_with(None))
    assert (bare["length_mm"], bare["channels"], bare["contact"]) == (None, [], None)


def test_what_changes_by_time_alone_is_no_change() -> None:
    surface = surface_of()
    pace = Pace([surface], 0.05, tells_status_at_once=False)

    def has_news(now_s: float) -> bool:
        due = pace.due(now_s)
        pace.note_told(due, now_s)
        return bool(due)

    surface.receive(parsed(TOUCHING), NOW_S)
    assert [has_news(NOW_S), has_news(NOW_S + 0.4)] == [True, False]
    assert [has_news(NOW_S + 0.6), has_news(NOW_S + 0.7)] == [True, False]  # stale, and more so
    surface.receive(parsed([0.5, 0.5, 0.0], sequence=2), NOW_S + 0.8)
    assert has_news(NOW_S + 0.8)


def test_a_summary_has_what_is_known_and_null_for_the_rest() -> None:
    bare = summarize(surface_with(None), NOW_S)
    assert (bare.model, bare.beam, bare.channels, bare.age_ms, bare.state) == (None, None, [], None, None)
    assert (bare.misfit, bare.misfit_limit, bare.notes, bare.health) == (None, None, [], None)
    surface = surface_of()
    surface.receive(parsed(*[RESTING, *[ODD] * 4]), NOW_S)
    odd = summarize(surface, NOW_S + 0.25)
    assert (odd.state, odd.misfit, odd.misfit_limit, odd.age_ms) == (State.UNEXPLAINED, 500.0, 30.0, 250.0)
    stale = summarize(surface, NOW_S + 0.6)
    assert (stale.state, stale.misfit, stale.misfit_limit, stale.age_ms) == (None, None, None, 600.0)


def refuse(surface: Surface, sequence: int, now_s: float) -> None:
    """Send a sample of another beam."""
    with pytest.raises(ProblemError):
        surface.receive(parsed(sequence=sequence).model_copy(update=OTHER), now_s)


def kinds(surface: Surface, *times_s: float) -> list[str]:
    return [str(getattr(status, "slug", status)) for status in (surface.view(now_s).status for now_s in times_s)]


def test_samples_of_another_beam_are_told_for_ten_seconds() -> None:
    surface = surface_of()
    refuse(surface, 1, NOW_S)
    assert kinds(surface, NOW_S, NOW_S + 10.0, NOW_S + 10.001) == ["other-beam", "other-beam", "no-samples"]


@pytest.mark.parametrize(("sequence", "kind"), [(6, "other-beam"), (4, "stale")])
def test_samples_of_another_beam_are_the_reason_once_the_contact_is_stale_if_they_are_newer(
    sequence: int, kind: str
) -> None:
    surface = surface_of()
    surface.receive(parsed(TOUCHING, sequence=5), NOW_S)
    refuse(surface, sequence, NOW_S)
    assert kinds(surface, NOW_S + 0.5, NOW_S + 0.6) == ["contact", kind]
    # Until samples come that state none.
    surface.receive(parsed(TOUCHING, sequence=7), NOW_S + 1)
    assert kinds(surface, NOW_S + 1, NOW_S + 1.6) == ["contact", "stale"]


def test_a_batch_says_which_channels_are_offered_unless_it_is_a_backlog() -> None:
    surface, ages_s = surface_of(), list[float]()
    surface.arrivals.add(ages_s.append)
    backlog = parsed(channels=["s3", "s2", "s1"]).model_copy(update={"backlog": True, "newest_age_ms": None})
    surface.receive(backlog, NOW_S)
    assert (surface.offered, surface.newest, ages_s) == (None, None, [])
    with pytest.raises(ProblemError):
        surface.receive(parsed([0.5, 0.5], channels=["s1", "spare"]), NOW_S)
    assert surface.offered == ["s1", "spare"]
    surface.receive(parsed(sequence=2, age_ms=250.0), NOW_S)
    assert (surface.offered, ages_s) == (["s1", "s2", "s3"], [0.25])
    surface.receive(parsed(sequence=2, age_ms=50.0), NOW_S)
    assert ages_s == [0.25]  # it was there
    surface.receive(parsed(sequence=3, age_ms=0.0), NOW_S + 1)
    assert ages_s == [0.25, 0.0]


def test_samples_that_moved_the_answer_need_not_be_weighed_again_under_the_same_model() -> None:
    surface = surface_of()
    received = surface.receive(parsed(RESTING, TOUCHING, sequence=4), NOW_S)
    assert list(received.weighed(model_of())) == [4, 5]
    assert received.weighed(model_of("other")) == received.weighed(None) == {}
    assert (received.accepted, received.repeated) == (2, 0)


def test_after_each_batch_that_moved_the_answer_and_no_other_it_is_said() -> None:
    surface, said = surface_of(), list[int]()
    surface.moves.add(lambda one: said.append(one.newest.sample.sequence if one.newest else 0))
    for first in (1, 1, 3):
        surface.receive(parsed(RESTING, TOUCHING, sequence=first), NOW_S)
    assert said == [2, 4]


def test_qualities_are_those_of_the_channels_of_the_model() -> None:
    surface = surface_of()
    assert surface.view(NOW_S).qualities == {}
    names = ["spare", "s3", "s2", "s1"]
    quality = ["stuck", "good", "saturated", "good"]
    surface.receive(parsed([0.1, 0.125, 0.25, 500.0], channels=names, quality=quality), NOW_S)
    assert surface.view(NOW_S).qualities == {"s1": Quality.OUT_OF_RANGE, "s2": Quality.SATURATED, "s3": Quality.GOOD}
    bare = surface_with(None)
    bare.receive(parsed([0.1, 0.125, 0.25, 0.5], channels=names, quality=quality), NOW_S)
    assert list(bare.view(NOW_S).qualities) == names
    assert bare.view(NOW_S).qualities["spare"] is Quality.STUCK


def test_channels_of_a_surface_without_a_model_are_out_too() -> None:
    surface = surface_with(None, section=SurfaceSection(degraded_after_s=0.005))
    surface.receive(parsed(*[TOUCHING] * 3, quality=["good", "stuck", "good"]), NOW_S)
    assert list(surface.channels_out.now) == ["s2"]


def test_a_pause_between_samples_counts_for_the_limit_of_age_at_most() -> None:
    """In the time for which a channel has been out."""
    for count, is_out in ((2, False), (3, True)):
        surface = surface_of(section=SurfaceSection(degraded_after_s=0.9))
        quality = ["good", "stuck", "good"]
        surface.receive(parsed(*[TOUCHING] * count, quality=quality, every_us=10_000_000), NOW_S)
        assert surface.channels_out.any is is_out


def test_what_a_technician_must_come_for_is_no_reason_for_others() -> None:
    surface = surface_of(section=SurfaceSection(degraded_after_s=0.004))
    surface.receive(parsed(*[TOUCHING] * 2, quality=["good", "stuck", "good"]), NOW_S)
    view = surface.view(NOW_S)
    assert view.notes == ["degraded", "unchecked"]
    contact = members_of(view)
    assert (contact["quality"], contact["degraded_channels"]) == ("degraded", ["s2"])
    found = [surface.view(NOW_S).problem, surface.find_fault(NOW_S)]
    assert [problem and problem.kind for problem in found] == [None, Kind.CHANNELS_OUT]
    surface.adopt(model_of("other"))  # of the same channels: the cable is still off
    assert surface.view(NOW_S).totals.channels_out.keys() == {"s2"}
    surface.adopt(model_of("renamed", prefix="t"))
    assert not surface.channels_out.any
    surface = surface_of()
    surface.receive(parsed(TOUCHING).model_copy(update={"notes": ["zeros"]}), NOW_S)
    found = [surface.view(NOW_S).problem, surface.find_fault(NOW_S)]
    assert [problem and problem.kind for problem in found] == [None, Kind.ZEROS_MOVED]


def test_two_daemons_are_noted_by_their_live_samples() -> None:
    surface, now_s = surface_of(), NOW_S
    for number in range(1, 9):
        for boot_id in ("boot-0001", "boot-0002"):
            now_s += 0.1
            backlog = parsed(boot_id=f"{boot_id}-old", sequence=number)
            backlog = backlog.model_copy(update={"backlog": True, "newest_age_ms": None})
            surface.receive(backlog, now_s, "elsewhere")
            surface.receive(parsed(TOUCHING, boot_id=boot_id, sequence=number), now_s, f"at {boot_id}")
            surface.receive(parsed().model_copy(update={"samples": []}), now_s, "asking")
    assert surface.duplicate_senders.at(now_s) == ("at boot-0001", "at boot-0002")
    assert surface.view(now_s).notes == ["senders"]


def test_a_misfit_has_two_decimals() -> None:
    surface = surface_of()
    surface.receive(parsed([0.5, 0.25, 0.251234]), NOW_S)
    view = surface.view(NOW_S)
    assert (view.misfit, view.misfit_limit) == (1.23, 30.0)
    assert members_of(view)["misfit"] == 1.23


CHANGED = ChannelHealth(
    gain_percent=9.0, gain_low_percent=8.0, gain_high_percent=10.0, zero_mm=None, zero_low_mm=None, zero_high_mm=None,
    since="2026-11-20T23:40:46.123Z", contacts=9, changed=True, changes=[],
)  # fmt: skip


def test_a_changed_channel_is_a_reason_for_a_technician_under_its_own_model_only() -> None:
    surface = surface_of()
    surface.receive(parsed(TOUCHING), NOW_S)
    channels = {"s1": CHANGED.model_copy(update={"changed": False}), "s3": CHANGED}
    for identity, found in ((model_of().identity, Kind.CHANGED_CHANNELS), ("other@1", None)):
        surface.health = SurfaceHealth(identity, channels)
        assert surface.view(NOW_S).problem is None
        problem = surface.find_fault(NOW_S)
        assert (problem and problem.kind) == found
        assert (problem.channels if problem else []) == (["s3"] if found else [])
    assert surface.channel_health is None
    # What prevents a contact comes first.
    assert surface.find_fault(NOW_S + 9) == surface.view(NOW_S + 9).problem is not None


def test_a_long_stretch_is_a_reason_only_for_a_technician() -> None:
    surface = surface_of(section=SurfaceSection(unexplained_after_s=0.01))
    surface.receive(parsed(RESTING, *[ODD] * 5), NOW_S)  # from the third on, 10 ms
    assert surface.find_fault(NOW_S) is None
    surface.receive(parsed(ODD, sequence=7, begin_us=1_795_218_046_123_456 + 30_000), NOW_S + 0.005)
    problem = surface.find_fault(NOW_S + 0.005)
    assert problem is not None
    assert (problem.kind, surface.view(NOW_S + 0.005).problem) == (Kind.UNEXPLAINED, None)
    assert "for over 0.01 s" in problem.detail


def test_a_name_that_nobody_has_is_repeated_up_to_the_length_of_a_name() -> None:
    registry = Registry([surface_of(), surface_of("press-8")])
    with pytest.raises(ProblemError) as caught:
        registry.named("x" * 65)
    assert caught.value.problem.detail == f"No surface is called {'x' * 64!r}. The surfaces are press-7, press-8."
    assert caught.value.problem.members == {"surfaces": ["press-7", "press-8"]}
    assert registry.chosen("press-8").name == "press-8"
    with pytest.raises(ProblemError) as caught:
        registry.chosen(None)
    assert caught.value.problem.kind is Kind.SURFACE_REQUIRED
    assert caught.value.problem.detail == "Name one of press-7, press-8, as in /contact?surface=press-7."
    assert Registry([surface_of()]).chosen(None).name == "press-7"


def test_without_a_surface_nothing_can_be_asked() -> None:
    registry = Registry([])
    for ask in (lambda: registry.named("a"), lambda: registry.chosen(None), lambda: registry.require_ready(NOW_S, {})):
        with pytest.raises(ProblemError) as caught:
            ask()
        assert caught.value.problem.kind is Kind.NO_SURFACE


def test_what_is_not_ready_is_listed_with_the_reason_of_each() -> None:
    fresh, waiting = surface_of(), surface_of("press-8")
    fresh.receive(parsed(TOUCHING), NOW_S)
    Registry([fresh]).require_ready(NOW_S, {"mqtt": ""})
    with pytest.raises(ProblemError) as caught:
        Registry([fresh, waiting]).require_ready(NOW_S, {"mqtt": "no broker", "opcua": ""})
    problem = caught.value.problem
    assert problem.detail == "press-8: The surface has no samples yet; [mqtt]: no broker"
    assert problem.members["missing"] == {"mqtt": "no broker"}
    surfaces = problem.members["surfaces"]
    assert isinstance(surfaces, Collection)
    assert list(surfaces) == ["press-8"]
    with pytest.raises(ProblemError):
        Registry([fresh]).require_ready(NOW_S, {"mqtt": "no broker"})
