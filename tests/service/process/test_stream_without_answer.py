"""The stream while there is no answer: a deflection that is too old, or of another beam, is not shown as current."""

from contextlib import ExitStack
from typing import Any

import httpx2
import pytest

from service.bench import batch_of
from service.process.conftest import Service, StartService
from support.network.plain_http import NO_TLS

from .test_streams import states

NOTHING = [(None, "missing")] * 3


def channels_while(service: Service, kind: str) -> list[tuple[float | None, str]]:
    """Return deflection and quality of each channel in the first state of a new stream with this problem."""
    with ExitStack() as stack:
        stream = httpx2.stream("GET", f"{service.url}/stream", trust_env=False, verify=NO_TLS, timeout=60)
        following = states(stack.enter_context(stream))
        found: dict[str, Any] = next(one for one in following if (one["problem"] or {}).get("type", "").endswith(kind))
        assert found["contact"] is None
        return [(one["deflection_mm"], one["quality"]) for one in found["channels"]]


@pytest.mark.promise("docs/reference/http.md", "null and `missing` without a fresh sample")
@pytest.mark.parametrize("is_bad", [False, True])
def test_a_stale_sample_shows_no_deflection(start_press: StartService, *, is_bad: bool) -> None:
    service = start_press(stale_ms=50)
    batch = batch_of([0.5, 0.25, 0.125], quality=["good", "good", "stuck"] if is_bad else None)
    assert service.post(batch).status_code == 200
    assert channels_while(service, ":stale") == NOTHING


def test_while_another_beam_sends_the_last_sample_of_this_one_shows_no_deflection(start_press: StartService) -> None:
    service = start_press(stale_ms=50)
    assert service.post(batch_of()).status_code == 200
    assert channels_while(service, ":stale") == NOTHING
    assert service.post(batch_of(sequence=2) | {"beam": "another"}).status_code == 503
    assert channels_while(service, ":other-beam") == NOTHING


def test_too_few_channels_show_what_there_is(start_press: StartService) -> None:
    service = start_press()
    quality = ["good", "missing", "missing"]
    assert service.post(batch_of([0.5, None, None], quality=quality)).status_code == 200
    assert channels_while(service, ":too-few-channels") == [(0.5, "good"), (None, "missing"), (None, "missing")]
