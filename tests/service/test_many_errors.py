"""A request that is wrong in several places: the first is told, the others are counted."""

from typing import Any

import pytest

from service.bench import TOKEN, Bench, batch_of, kind

LISTED = 10
"""Places that an answer lists at most."""


def told(bench: Bench, body: dict[str, Any] | bytes, path: str = "/surfaces/press-7/samples") -> dict[str, Any]:
    answer = bench.post(body, path, TOKEN)
    assert (answer.status_code, kind(answer)) == (422, "invalid-request")
    found: dict[str, Any] = answer.json()
    return found


@pytest.mark.parametrize("wrong", [1, 2, 3, LISTED, LISTED + 1, 200])
def test_a_batch_that_is_wrong_in_many_places_counts_them(bench: Bench, wrong: int) -> None:
    body = batch_of(*[[0.0, 0.0, 0.0]] * 200)
    for sample in body["samples"][:wrong]:
        sample["sequence"] = "x"
    problem = told(bench, body)
    first, _, more = problem["detail"].partition(" (and ")
    assert first.startswith("#/samples/0/sequence: ")
    assert more == (f"{wrong - 1} more)" if wrong > 1 else "")
    assert [one["pointer"] for one in problem["errors"]] == [
        f"#/samples/{index}/sequence" for index in range(min(wrong, LISTED))
    ]


@pytest.mark.parametrize(("query", "more"), [("?run=c", ""), ("", " (and 1 more)"), ("?step=x", " (and 1 more)")])
def test_an_address_that_is_wrong_in_many_places_counts_them(bench: Bench, query: str, more: str) -> None:
    problem = told(bench, b"", f"/surfaces/press-7/commissioning/skip{query}")
    assert problem["detail"] == f"{problem['errors'][0]['pointer']}: {problem['errors'][0]['detail']}{more}"
    assert len(problem["errors"]) == (2 if more else 1)
