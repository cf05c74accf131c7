"""Boots of a surface that are still in the log: which of them a batch names, and what is said of their delivery."""

import pytest

from beamtouch_daemon.delivery.boots import SurfaceLogs
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.sending import send
from beamtouch_service.samples import MAX_EARLIER
from support.network.free_ports import free_port

from .publishing import boot, taken
from .service import TOKEN, Service, serving

pytestmark = pytest.mark.anyio


async def test_of_too_many_boots_the_newest_are_named() -> None:
    logs, last = SurfaceLogs("bench"), MAX_EARLIER + 2
    boots = [logs.begin(boot(f"boot-{number:04}"), 10) for number in range(last + 1)]
    for one in boots[:-1]:
        one.log.put(taken(1, 1))
    assert logs.others(boots[0]) == [f"boot-{number:04}" for number in range(3, last + 1)]


async def test_a_surface_that_is_only_in_the_log_file_says_that_it_works_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO")
    logs = SurfaceLogs("bench")
    former = logs.begin(boot(), 10)
    former.log.put(taken(1, 3))
    logs.present = None
    batch = former.log.head.model_copy(update={"samples": [one.sample for one in taken(1, 3)], "backlog": True})
    async with serving(Service()) as service:
        for url in (f"http://127.0.0.1:{free_port()}", service.url):
            client = ServiceClient(url, TOKEN)
            await send(client, logs, former, batch)
            await client.__aexit__()
    failed, again = [words for words in caplog.messages if words.startswith("bench: publishing")]
    assert "no answer from" in failed
    assert again.startswith("bench: publishing: works again after")
