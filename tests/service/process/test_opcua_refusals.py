"""What the OPC UA server refuses: writes, strangers, and what is another client's or would hide a contact."""

import asyncio
import math
import shutil
import signal
import socket
import ssl
from contextlib import ExitStack
from pathlib import Path

import pytest
from asyncua import Client, ua
from asyncua.client.ua_session import UaSession
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

from service.bench import batch_of
from service.process.opcua_client import TIMEOUT_S, Changes, connected, read, start
from service.process.opcua_hello import HELLO, is_open
from support.network.certificates import make_certificate
from support.running.waiting import wait_until

from .conftest import StartService


@pytest.mark.promise("docs/how-to/opcua.md", "Nobody can write.")
def test_nobody_can_write(start_press: StartService) -> None:
    _, url = start(start_press, 60_000)

    async def write() -> None:
        async with connected(url) as client:
            force = client.get_node(ua.NodeId("press-7/force_n", await client.get_namespace_index("urn:beamtouch")))
            with pytest.raises(ua.UaStatusCodeError, match=r"NotWritable|AccessDenied"):
                await force.write_value(3.0)

    asyncio.run(write())


@pytest.mark.promise(
    "docs/how-to/opcua.md", "A filter with a deadband is refused with `BadMonitoredItemFilterUnsupported`."
)
def test_a_deadband_is_refused_as_it_would_hide_the_end_of_a_contact(start_press: StartService) -> None:
    _, url = start(start_press, 60_000)

    async def ask() -> None:
        async with connected(url) as client:
            node = client.get_node(ua.NodeId("press-7/position_mm", await client.get_namespace_index("urn:beamtouch")))
            subscription = await client.create_subscription(50, Changes())
            for kind in (ua.DeadbandType.Absolute, ua.DeadbandType.Percent):
                with pytest.raises(ua.UaStatusCodeError, match="BadMonitoredItemFilterUnsupported"):
                    await subscription.deadband_monitor(node, 0.5, kind)
            # The item beside it is not there either: a client cannot mistake the answer.
            filters = [
                ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, ua.DeadbandType.Absolute, 0.5),
                ua.DataChangeFilter(ua.DataChangeTrigger.StatusValueTimestamp, ua.DeadbandType.None_),
                ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, ua.DeadbandType.None_),
            ]
            items = [
                ua.MonitoredItemCreateRequest(
                    ua.ReadValueId(node.nodeid, ua.AttributeIds.Value),
                    ua.MonitoringMode.Reporting,
                    ua.MonitoringParameters(handle, Filter=asked),
                )
                for handle, asked in enumerate(filters)
            ]
            for refused in (items[::2], items[1:]):
                with pytest.raises(ua.UaStatusCodeError, match="BadMonitoredItemFilterUnsupported"):
                    await subscription.create_monitored_items(refused)
            (given,) = await subscription.create_monitored_items(items[2:])
            with pytest.raises(ua.UaStatusCodeError, match="BadServiceUnsupported"):
                await subscription.modify_monitored_item(given, 20, mod_filter_val=0.5)

    asyncio.run(ask())


@pytest.mark.promise(
    "docs/reference/service-configuration.md", "The only user. Default: everybody on this machine may read."
)
def test_only_the_user_reads_and_in_no_session_of_another_and_names_with_dots_are_nodes_of_their_own(
    start_press: StartService, tmp_path: Path
) -> None:
    (tmp_path / "password").write_text("a long password\n")
    zone = "[surfaces.press-7.zones.state]\nfrom_mm = 0\nto_mm = 9"
    others = '[surfaces."press-7.model"]\n[surfaces."press-7.zones"]'
    account = 'username = "scada"\npassword_file = "password"'
    _, url = start(start_press, 2000, f"{account}\n{zone}\n{others}")

    async def connect() -> None:
        for user, password in ((None, ""), ("scada", "wrong"), ("admin", "a long password")):
            with pytest.raises(ua.UaStatusCodeError, match=r"IdentityToken|UserAccess"):
                async with connected(url, user, password):
                    pass
        async with connected(url, "scada", "a long password") as client:
            assert await read(client)
            index = await client.get_namespace_index("urn:beamtouch")
            for name in ("press-7/model", "press-7/zones/state", "press-7.zones/state", "press-7.model/model"):
                assert await client.get_node(ua.NodeId(name, index)).read_node_class() is ua.NodeClass.Variable
            for name in ("press-7", "press-7.model", "press-7.zones"):
                assert await client.get_node(ua.NodeId(name, index)).read_node_class() is ua.NodeClass.Object

    async def take_over() -> None:
        async with connected(url, "scada", "a long password") as client:
            stranger = Client(url, timeout=TIMEOUT_S, watchdog_intervall=TIMEOUT_S)
            await stranger.connect_socket()
            await stranger.send_hello()
            await stranger.open_secure_channel()
            # Sessions are numbered, so that this is easily guessed.
            stranger.uaclient.session.restore_authentication_token(client.uaclient.session.authentication_token)
            with pytest.raises(ua.UaStatusCodeError, match="BadSessionIdInvalid"):
                await stranger.uaclient.activate_session(ua.ActivateSessionParameters())
            with pytest.raises(ua.UaStatusCodeError, match="BadUserAccessDenied"):
                await read(stranger)
            stranger.disconnect_socket()
            assert await read(client)

    asyncio.run(connect())
    asyncio.run(take_over())


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    "A publishing interval below 10 ms, also 0, or above an hour is refused with `BadInvalidArgument`",
    "at most 100 values of a variable wait for a client.",
)
def test_a_client_adds_no_server_and_its_subscriptions_are_bounded(start_press: StartService) -> None:
    service, url = start(start_press, 2000, "interval_ms = 50")

    async def ask() -> None:
        async with connected(url) as client:
            known = [one.ApplicationUri for one in await client.find_servers()]
            other = ua.RegisteredServer("urn:other", ServerNames=[ua.LocalizedText("Other")])
            with pytest.raises(ua.UaStatusCodeError, match="BadServiceUnsupported"):
                await client.uaclient.register_server(other)
            assert [one.ApplicationUri for one in await client.find_servers()] == known == ["urn:beamtouch:service"]
            session = client.uaclient.session
            for interval_ms in (0, 0.001, 9.9, math.nan, -1, math.inf, 3_600_001):
                asked = ua.CreateSubscriptionParameters(interval_ms, 1000, 10, PublishingEnabled=True)
                with pytest.raises(ua.UaStatusCodeError, match="BadInvalidArgument"):
                    await session.create_subscription(asked, lambda _message: None)
            asked = ua.CreateSubscriptionParameters(10, 1_000_000, 1_000_000, PublishingEnabled=True)
            given = await session.create_subscription(asked, lambda _message: None)
            # As long as these, a client that hangs would keep its subscription, and one that waits would hear nothing.
            assert (given.RevisedLifetimeCount, given.RevisedMaxKeepAliveCount) == (1000, 100)
            index = await client.get_namespace_index("urn:beamtouch")
            age = ua.ReadValueId(ua.NodeId("press-7/age_ms", index), ua.AttributeIds.Value)
            for size in (0, 100_000):
                item = ua.MonitoredItemCreateRequest(
                    age, ua.MonitoringMode.Reporting, ua.MonitoringParameters(1, QueueSize=size)
                )
                items = ua.CreateMonitoredItemsParameters(given.SubscriptionId, ItemsToCreate=[item])
                (created,) = await session.create_monitored_items(items)
                assert created.RevisedQueueSize == 100

    asyncio.run(ask())
    _, errors = service.stop(signal.SIGTERM)
    (line,) = [line for line in errors.splitlines() if "publishing interval of 0 ms" in line]
    assert "OPC UA server: 1 requests refused: a publishing interval of 0 ms, not of 10 ms to an hour" in line


async def follow(session: UaSession, lengths: list[int]) -> set[str]:
    """Follow paths of so many elements; return how that went."""
    none = ua.RelativePathElement(TargetName=ua.QualifiedName("none"))
    paths = [ua.BrowsePath(ua.NodeId(ua.ObjectIds.RootFolder), ua.RelativePath([none] * count)) for count in lengths]
    return {one.StatusCode.name for one in await session.translate_browsepaths_to_nodeids(paths)}


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    (
        "2000 subscribed variables, of all clients together; at most 500 nodes in a request, 20 to browse, or 20 paths "
        "of 200 elements in all"
    ),
)
def test_requests_and_subscribed_variables_are_bounded(start_press: StartService) -> None:
    _, url = start(start_press, 60_000)

    async def ask() -> None:
        async with connected(url) as client:
            index = await client.get_namespace_index("urn:beamtouch")
            limit = await client.get_node(
                ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead
            ).read_value()
            node = ua.ReadValueId(ua.NodeId("press-7/state", index), ua.AttributeIds.Value)
            session = client.uaclient.session
            assert len(await session.read(ua.ReadParameters(NodesToRead=[node] * limit))) == limit == 500
            with pytest.raises(ua.UaStatusCodeError, match="BadTooManyOperations"):
                await session.read(ua.ReadParameters(NodesToRead=[node] * (limit + 1)))
            browsed = [ua.BrowseDescription(NodeId=ua.NodeId("press-7", index))] * 21
            assert len(await session.browse(ua.BrowseParameters(NodesToBrowse=browsed[:20]))) == 20
            with pytest.raises(ua.UaStatusCodeError, match="BadTooManyOperations"):
                await session.browse(ua.BrowseParameters(NodesToBrowse=browsed))
            assert await follow(session, [10] * 20) == {"BadNoMatch"}
            for lengths, code in (([1] * 21, "TooManyOperations"), ([201], "TooManyOperations"), ([0], "NothingToDo")):
                with pytest.raises(ua.UaStatusCodeError, match=f"Bad{code}"):
                    await follow(session, lengths)
            items = [
                ua.MonitoredItemCreateRequest(node, ua.MonitoringMode.Reporting, ua.MonitoringParameters(handle))
                for handle in range(limit)
            ]

            async def subscribe(count: int) -> int:
                asked = ua.CreateSubscriptionParameters(3.6e6, 1000, 100, PublishingEnabled=True)
                number = (await session.create_subscription(asked, lambda _message: None)).SubscriptionId
                for first in range(0, count, limit):
                    part = ua.CreateMonitoredItemsParameters(number, ItemsToCreate=items[: count - first])
                    created = await session.create_monitored_items(part)
                    assert {one.StatusCode.name for one in created} == {"Good"}
                return int(number)

            most, more = await subscribe(4 * limit), await subscribe(0)
            one_more = ua.CreateMonitoredItemsParameters(more, ItemsToCreate=items[:1])
            with pytest.raises(ua.UaStatusCodeError, match="BadTooManyMonitoredItems"):
                await session.create_monitored_items(one_more)
            await session.delete_subscriptions([most])
            assert await session.create_monitored_items(one_more)

    asyncio.run(ask())


@pytest.mark.promise("docs/how-to/opcua.md", "64 connections")
def test_connections_are_bounded(start_press: StartService) -> None:
    _, url = start(start_press, 60_000)
    asyncio.run(asyncio.to_thread(wait_until, lambda: is_open(url)))
    port = int(url.rstrip("/").rpartition(":")[2])

    def is_refused(line: socket.socket) -> bool:
        line.settimeout(TIMEOUT_S)
        try:
            line.sendall(HELLO)
            return line.recv(4) != b"ACKF"
        except ConnectionError:
            return True

    with ExitStack() as lines:
        taken = [
            lines.enter_context(socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S)) for _ in range(64)
        ]
        with socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S) as more:
            assert is_refused(more)
        # The server learns of the end of the connection before in its own time.
        assert not is_refused(taken[-2])
    asyncio.run(asyncio.to_thread(wait_until, lambda: is_open(url)))


MOST_SUBSCRIPTIONS = 128
"""Of a server."""


@pytest.mark.promise("docs/how-to/opcua.md", "and ends with its connection, with all of them")
@pytest.mark.parametrize("says_so", [True, False])
def test_subscriptions_end_with_the_session_of_their_client(start_press: StartService, says_so: bool) -> None:
    _, url = start(start_press, 2000)
    seldom = ua.CreateSubscriptionParameters(3.6e6, 1000, 100, PublishingEnabled=True)

    async def subscribe(client: Client) -> None:
        await client.uaclient.session.create_subscription(seldom, lambda _message: None)

    async def use_up() -> None:
        client = Client(url, timeout=TIMEOUT_S, watchdog_intervall=TIMEOUT_S)
        await asyncio.to_thread(wait_until, lambda: is_open(url))
        await client.connect()
        for _ in range(MOST_SUBSCRIPTIONS):
            await subscribe(client)
        with pytest.raises(ua.UaStatusCodeError, match="BadTooManySubscriptions"):
            await subscribe(client)
        if says_so:
            await client.uaclient.close_session(delete_subscriptions=False)
        client.disconnect_socket()

        async with connected(url) as other:
            for _ in range(100):
                try:
                    return await subscribe(other)
                except ua.UaStatusCodeError:
                    await asyncio.sleep(0.1)  # the server learns of the end of a connection in its own time
            raise AssertionError("the subscriptions of a client that is gone stay")

    asyncio.run(use_up())


def application_certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """Write a certificate as OPC UA applications have them, and its key beside the folder; returns both."""
    folder.mkdir()
    use = "keyUsage=digitalSignature,nonRepudiation,keyEncipherment,dataEncipherment,keyCertSign"
    certificate, key = make_certificate(folder, f"URI:urn:{name},DNS:localhost", ("rsa:2048",), ("-addext", use))
    return certificate.rename(folder / f"{name}.pem"), key.rename(folder.parent / f"{name}-key.pem")


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    "with it, only one whose certificate, or that of its issuer, lies there.",
    "Files may be PEM or DER, whatever their names.",
)
def test_with_a_certificate_only_trusted_clients_connect_and_only_encrypted(
    start_press: StartService, tmp_path: Path
) -> None:
    certificate, key = application_certificate(tmp_path / "own", "server")
    trusted, stranger = (application_certificate(tmp_path / folder, folder) for folder in ("clients", "strangers"))
    # What a file is, is said by its content: names differ from plant to plant.
    key.rename(tmp_path / "server.key")
    (tmp_path / "trusted").mkdir()
    shutil.copy(trusted[0], tmp_path / "trusted" / "client.crt")
    keys = f'certificate_file = "{certificate}"\nkey_file = "server.key"\ntrusted_folder = "trusted"'
    service, url = start(start_press, 2000, keys)

    async def connect(certificate: Path, key: Path, named: bytes | None) -> set[str]:
        await asyncio.to_thread(wait_until, lambda: is_open(url))
        client = Client(url, timeout=TIMEOUT_S, watchdog_intervall=TIMEOUT_S)
        client.application_uri = f"urn:{certificate.stem}"
        await client.set_security(SecurityPolicyBasic256Sha256, certificate, key)
        create = client.uaclient.create_session

        async def create_session(parameters: ua.CreateSessionParameters) -> ua.CreateSessionResult:
            parameters.ClientCertificate = named
            return await create(parameters)

        client.uaclient.create_session = create_session
        async with client:
            return {one.StatusCode.name for one in (await read(client)).values()}

    own, other = (ssl.PEM_cert_to_DER_cert(one.read_text()) for one, _ in (trusted, stranger))
    assert asyncio.run(connect(*trusted, own)) == {"BadWaitingForInitialData"}
    # A certificate is public: to name that of somebody else, or none, opens nothing.
    for named in (other, own, None):
        with pytest.raises(ua.UaStatusCodeError, match="BadCertificateUntrusted"):
            asyncio.run(connect(*stranger, named))
    _, errors = service.stop(signal.SIGTERM)
    (line,) = [line for line in errors.splitlines() if "a client is refused" in line]
    assert "its certificate is not trusted" in line
    assert "check the clock of this machine" in line


@pytest.mark.promise("docs/reference/service-configuration.md", "With `key_file`, clients must sign and encrypt.")
def test_a_server_with_a_certificate_refuses_clients_that_do_not_encrypt(
    start_press: StartService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    certificate, _ = application_certificate(tmp_path / "own", "server")
    _, url = start(start_press, 2000, f'certificate_file = "{certificate}"\nkey_file = "server-key.pem"')
    # The server offers no such endpoint; a client may ask for one all the same.
    monkeypatch.setattr(Client, "find_endpoint", lambda endpoints, _mode, _policy: endpoints[0])

    async def connect_openly() -> None:
        async with connected(url):
            pass

    with pytest.raises(ua.UaStatusCodeError, match="BadSecurityModeRejected"):
        asyncio.run(connect_openly())


@pytest.mark.promise("docs/how-to/opcua.md", "A session reaches its own subscriptions only")
def test_nobody_ends_or_takes_over_the_subscription_of_another_client(start_press: StartService) -> None:
    service, url = start(start_press, 60_000, "interval_ms = 50")

    async def try_to_disturb() -> None:
        changes = Changes()
        async with connected(url) as client, connected(url) as stranger:
            node = client.get_node(ua.NodeId("press-7/sequence", await client.get_namespace_index("urn:beamtouch")))
            subscription = await client.create_subscription(50, changes)
            item = await subscription.subscribe_data_change(node)
            number = subscription.subscription_id
            own = (await stranger.create_subscription(50, Changes())).subscription_id
            assert own != number
            stranger_session = stranger.uaclient.session
            with pytest.raises(ua.UaStatusCodeError, match="BadServiceUnsupported"):
                await stranger.uaclient.transfer_subscriptions(ua.TransferSubscriptionsParameters([number]))
            pause = ua.SetPublishingModeParameters(PublishingEnabled=False, SubscriptionIds=[number])
            stop = ua.SetMonitoringModeParameters(number, ua.MonitoringMode.Disabled, [item])
            for attempt in (
                stranger_session.set_publishing_mode(pause),
                stranger_session.set_monitoring_mode(stop),
                stranger_session.delete_subscriptions([own, number]),
                stranger_session.delete_monitored_items(ua.DeleteMonitoredItemsParameters(number, [item])),
                stranger_session.republish(number, 1),
            ):
                with pytest.raises(ua.UaStatusCodeError, match="BadSubscriptionIdInvalid"):
                    await attempt
            assert [answer.name for answer in await stranger.uaclient.delete_subscriptions([own])] == ["Good"]
            assert (await asyncio.to_thread(service.post, batch_of([0.0] * 3))).status_code == 200
            told = changes.found.setdefault("press-7/sequence", [])
            await asyncio.to_thread(wait_until, lambda: bool(told) and told[-1].Value.Value == 1)

    asyncio.run(try_to_disturb())
