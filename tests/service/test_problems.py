"""A problem as a value: its body, and the channels that are its cause."""

import pytest

from beamtouch_service.problems import Kind, Problem, ProblemError


def test_a_body_has_the_members_of_rfc_9457_and_those_of_its_kind() -> None:
    plain = Problem(Kind.TOO_LARGE, "At most 1 MiB.")
    assert plain.body() == {
        "type": "urn:beamtouch:problem:too-large",
        "title": "The body is too large",
        "status": 413,
        "detail": "At most 1 MiB.",
    }
    of_surface = Problem(Kind.STALE, "Too old.", "press-7", {"age_ms": 700.5})
    assert list(of_surface.body().items())[4:] == [("surface", "press-7"), ("age_ms", 700.5)]
    assert of_surface.body()["status"] == 503


@pytest.mark.parametrize(
    ("members", "channels"),
    [
        ({}, []),
        ({"bad_channels": {"s1": "missing", "s3": "stuck"}}, ["s1", "s3"]),
        ({"channels_out": {"s2": {}}, "changed_channels": {"s4": {}}}, ["s2", "s4"]),
        ({"suspect": "s3"}, ["s3"]),
        ({"suspect": None, "channels_out": {"s2": {}}, "other": {"s9": 1}}, ["s2"]),
    ],
)
def test_the_channels_that_are_the_cause_are_those_of_its_members(
    members: dict[str, object], channels: list[str]
) -> None:
    assert Problem(Kind.CHANNELS_OUT, "Out.", "press-7", members).channels == channels


def test_an_error_carries_its_problem_and_headers_of_its_own() -> None:
    problem = Problem(Kind.STOPPING, "Come again.")
    headers = {"Retry-After": "5"}
    error = ProblemError(problem, headers)
    headers.clear()
    assert (str(error), error.problem, error.headers) == ("Come again.", problem, {"Retry-After": "5"})
    assert ProblemError(problem).headers == {}
