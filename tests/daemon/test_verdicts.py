"""What an answer of the service, or of a proxy in front of it, means for a batch, and what is said of it."""

import json

import pytest

from beamtouch_daemon.delivery.client import ServiceAnswer, Verdict, _certificate_advice
from beamtouch_service.samples import Receipt

RECEIPT = Receipt(accepted=1, repeated=0, durable=1, expected=2, stale_ms=500.0).model_dump_json().encode()
PAGE = b"<html>no</html>"
TAKEN, LATER, REFUSED, SMALLER = Verdict.TAKEN, Verdict.LATER, Verdict.REFUSED, Verdict.SMALLER


def problem(kind: str, detail: str = "") -> bytes:
    return json.dumps({"type": f"urn:beamtouch:problem:{kind}", "detail": detail}).encode()


@pytest.mark.parametrize(
    ("status", "verdict"),
    [
        *[(200, LATER), (399, LATER), (400, REFUSED), (407, REFUSED), (408, LATER), (409, REFUSED)],
        *[(412, REFUSED), (413, SMALLER), (414, REFUSED), (428, REFUSED), (429, LATER), (430, REFUSED)],
        *[(499, REFUSED), (500, LATER), (503, LATER)],
    ],
)
def test_a_bare_status_is_a_refusal_only_if_it_says_that_the_request_is_wrong(status: int, verdict: Verdict) -> None:
    assert ServiceAnswer(status, PAGE).verdict is verdict


@pytest.mark.parametrize(("status", "is_taken"), [(199, False), (200, True), (299, True), (300, False)])
def test_a_receipt_counts_with_a_status_of_success(status: int, is_taken: bool) -> None:
    answer = ServiceAnswer(status, RECEIPT)
    assert (answer.is_success, answer.receipt is not None) == (is_taken, is_taken)
    assert answer.verdict is (TAKEN if is_taken else LATER)


@pytest.mark.parametrize(
    ("status", "kind", "verdict"),
    [
        (422, "invalid-request", SMALLER),
        (400, "malformed-json", SMALLER),
        (500, "too-large", SMALLER),
        (503, "other-beam", REFUSED),
        (422, "missing-channels", REFUSED),
        (503, "no-model", LATER),
    ],
)
def test_the_type_of_a_problem_of_the_service_decides(status: int, kind: str, verdict: Verdict) -> None:
    answer = ServiceAnswer(status, problem(kind))
    assert (answer.verdict, answer.problem) == (verdict, f"urn:beamtouch:problem:{kind}")


NO_SERVICE = "status 404: no service is there; is the path in publish.url the one that the proxy passes on?"


@pytest.mark.parametrize(
    ("status", "content", "said"),
    [
        (200, PAGE, "the answer is no receipt; is publish.url the address of another program?"),
        (401, problem("unauthorized", "No."), "status 401: wrong token; correct publish.token_file and restart"),
        (404, PAGE, NO_SERVICE),
        (404, problem("not-found", "No."), NO_SERVICE),
        (404, problem("unknown-surface", "No surface."), "status 404: No surface."),
        (403, problem("not-found", "No."), "status 403: No."),
        (503, problem("busy", "x" * 401), f"status 503: {'x' * 400}"),
        (502, PAGE, "status 502"),
    ],
)
def test_an_answer_is_explained_in_one_line(status: int, content: bytes, said: str) -> None:
    assert ServiceAnswer(status, content).explanation == said


@pytest.mark.parametrize(
    ("codes", "advice"),
    [
        ({9, 10}, "renew it, or check the clock of this machine"),
        ({62, 64}, "publish.url must have a name or address that the certificate states"),
        (
            {8, 11, 18, 61, 63, 65},
            "publish.certificate_file must be the service's certificate, or that of its authority",
        ),
    ],
    ids=["not valid now", "of another name", "of a stranger"],
)
def test_a_certificate_that_is_refused_is_told_what_to_change(codes: set[int], advice: str) -> None:
    """By the codes of OpenSSL, `x509_vfy.h`."""
    assert {_certificate_advice(code) for code in codes} == {advice}
