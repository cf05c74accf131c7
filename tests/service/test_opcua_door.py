"""What the door before the sessions of OPC UA lets pass, to the last one that is allowed, and what it refuses."""

import asyncio
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest
from asyncua import Server, ua
from asyncua.common.callback import Callback, CallbackType
from asyncua.common.utils import Buffer, ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_session import SessionState
from asyncua.ua.ua_binary import struct_to_binary

from beamtouch_service.outputs.opcua.door import Door, Sessions
from beamtouch_service.outputs.opcua.security import Clients, Security

NODE = ua.NodeId(85)
READ, BROWSE = ua.ReadValueId(NODE), ua.BrowseDescription(NodeId=NODE)
STEP = ua.RelativePathElement(TargetName=ua.QualifiedName("none"))


def path(elements: int) -> ua.BrowsePath:
    return ua.BrowsePath(NODE, ua.RelativePath([STEP] * elements))


def read(count: int) -> ua.ReadParameters:
    return ua.ReadParameters(NodesToRead=[READ] * count)


def browse(count: int) -> ua.BrowseParameters:
    return ua.BrowseParameters(NodesToBrowse=[BROWSE] * count)


def follow(*elements: int) -> ua.TranslateBrowsePathsToNodeIdsParameters:
    return ua.TranslateBrowsePathsToNodeIdsParameters([path(count) for count in elements])


def interval(ms: float) -> ua.CreateSubscriptionParameters:
    return ua.CreateSubscriptionParameters(ms, 100, 10)


def items(subscription: int, count: int, wanted: object = None) -> ua.CreateMonitoredItemsParameters:
    item = ua.MonitoredItemCreateRequest(
        READ, ua.MonitoringMode.Reporting, ua.MonitoringParameters(1, Filter=cast("Any", wanted))
    )
    return ua.CreateMonitoredItemsParameters(subscription, ItemsToCreate=[item] * count)


class Nodes:
    """What the door needs of a server."""

    def __init__(self) -> None:
        self.limits = SimpleNamespace(max_message_size=0)
        self.written: dict[int, int] = {}
        self.calls: dict[CallbackType, Callable[..., None]] = {}

    def get_node(self, nodeid: ua.NodeId) -> SimpleNamespace:
        async def write(value: int, kind: ua.VariantType) -> None:
            assert kind is ua.VariantType.UInt32
            self.written[cast("int", nodeid.Identifier)] = value

        return SimpleNamespace(write_value=write)

    def subscribe_server_callback(self, kind: CallbackType, call: Callable[..., None]) -> None:
        self.calls[kind] = call


class Guarded:
    """A door before the sessions of two clients, with a subscription each: 7 and 8."""

    def __init__(self) -> None:
        self.sessions = Sessions(Clients(None, None, None, are_encrypted=False))
        self.door, self.nodes = Door(self.sessions), Nodes()
        asyncio.run(self.door.guard(cast("Any", self.nodes)))
        self.user, self.other = User(role=UserRole.User), User(role=UserRole.User)
        self.held = [self.sessions.create_session(name, user) for name, user in (("a", self.user), ("b", self.other))]
        self.subscriptions = cast("dict[int, Any]", self.sessions.subscription_service.subscriptions)
        for number, session in zip((7, 8), self.held, strict=True):
            self.subscriptions[number] = SimpleNamespace(session_id=session.session_id)

    def ask(self, name: str, parameters: object = None) -> str:
        """Return the code with which a request of the first client is refused; empty if it passes."""
        kind = ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary"))
        body = Buffer(struct_to_binary(parameters) if parameters else b"")
        try:
            assert self.door.check_validity(self.user, kind, body) is True
        except ServiceError as error:
            return str(ua.StatusCode(error.code).name)
        return ""

    def create(self, subscription: int, *good: bool) -> None:
        """Tell the door that so many items were created, or not."""
        results = [
            SimpleNamespace(StatusCode=ua.StatusCode(ua.StatusCodes.Good if one else 0x80000000)) for one in good
        ]
        event = SimpleNamespace(request_params=SimpleNamespace(SubscriptionId=subscription), response_params=results)
        self.nodes.calls[CallbackType.ItemSubscriptionCreated](event, None)

    def delete(self, subscription: int, *good: bool) -> None:
        codes = [ua.StatusCode(ua.StatusCodes.Good if one else 0x80000000) for one in good]
        event = SimpleNamespace(request_params=SimpleNamespace(SubscriptionId=subscription), response_params=codes)
        self.nodes.calls[CallbackType.ItemSubscriptionDeleted](event, None)


@pytest.fixture
def guarded() -> Guarded:
    return Guarded()


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    "2000 subscribed variables, of all clients together; at most 500 nodes in a request, 20 to browse, or 20 paths",
    "A publishing interval below 10 ms, also 0, or above an hour is refused with `BadInvalidArgument`",
)
@pytest.mark.parametrize(
    ("name", "parameters", "code"),
    [
        ("Read", read(500), ""),
        ("Read", read(501), "BadTooManyOperations"),
        ("Browse", browse(20), ""),
        ("Browse", browse(21), "BadTooManyOperations"),
        ("TranslateBrowsePathsToNodeIds", follow(*[10] * 20), ""),
        ("TranslateBrowsePathsToNodeIds", follow(*[1] * 21), "BadTooManyOperations"),
        ("TranslateBrowsePathsToNodeIds", follow(101, 100), "BadTooManyOperations"),
        ("TranslateBrowsePathsToNodeIds", follow(1, 0), "BadNothingToDo"),
        ("TranslateBrowsePathsToNodeIds", follow(1), ""),
        ("CreateSubscription", interval(10.0), ""),
        ("CreateSubscription", interval(9.99), "BadInvalidArgument"),
        ("CreateSubscription", interval(3_600_000.0), ""),
        ("CreateSubscription", interval(3_600_000.5), "BadInvalidArgument"),
        ("CreateSubscription", interval(math.nan), "BadInvalidArgument"),
        ("CreateMonitoredItems", items(7, 500), ""),
        ("CreateMonitoredItems", items(7, 501), "BadTooManyOperations"),
        ("CreateMonitoredItems", items(8, 1), "BadSubscriptionIdInvalid"),
        ("CreateMonitoredItems", items(9, 1), "BadSubscriptionIdInvalid"),
        ("CreateMonitoredItems", items(7, 1, ua.EventFilter()), ""),
        ("CreateMonitoredItems", items(7, 1, ua.DataChangeFilter(ua.DataChangeTrigger.Status)), ""),
        (
            "CreateMonitoredItems",
            items(7, 1, ua.DataChangeFilter(ua.DataChangeTrigger.StatusValueTimestamp)),
            "BadMonitoredItemFilterUnsupported",
        ),
        (
            "CreateMonitoredItems",
            items(7, 1, ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, ua.DeadbandType.Absolute, 0.5)),
            "BadMonitoredItemFilterUnsupported",
        ),
        ("DeleteMonitoredItems", ua.DeleteMonitoredItemsParameters(7, [1]), ""),
        ("DeleteMonitoredItems", ua.DeleteMonitoredItemsParameters(8, [1]), "BadSubscriptionIdInvalid"),
        ("SetMonitoringMode", ua.SetMonitoringModeParameters(8), "BadSubscriptionIdInvalid"),
        ("Republish", ua.RepublishParameters(8, 1), "BadSubscriptionIdInvalid"),
        ("DeleteSubscriptions", ua.DeleteSubscriptionsParameters([7]), ""),
        ("DeleteSubscriptions", ua.DeleteSubscriptionsParameters([7, 8]), "BadSubscriptionIdInvalid"),
        ("SetPublishingMode", ua.SetPublishingModeParameters(True, [8, 7]), "BadSubscriptionIdInvalid"),
        ("Write", None, "BadUserAccessDenied"),
        ("Publish", None, ""),
        ("CloseSecureChannel", None, ""),
        ("ModifySubscription", None, ""),
        ("RegisterNodes", None, ""),
        ("UnregisterNodes", None, ""),
        ("ModifyMonitoredItems", None, "BadServiceUnsupported"),
        ("TransferSubscriptions", None, "BadServiceUnsupported"),
    ],
)
def test_a_request_passes_up_to_its_limit_and_only_for_what_is_the_clients_own(
    guarded: Guarded, name: str, parameters: object, code: str
) -> None:
    assert guarded.ask(name, parameters) == code


@pytest.mark.parametrize(
    ("name", "parameters", "words"),
    [
        ("Read", read(501), "more than 500 nodes in one request"),
        ("Browse", browse(21), "more than 20 nodes in one request"),
        ("TranslateBrowsePathsToNodeIds", follow(201), "more than 200 elements of paths in one request"),
        ("TranslateBrowsePathsToNodeIds", follow(0), "a path without an element"),
        ("CreateSubscription", interval(2.5), "a publishing interval of 2.5 ms, not of 10 ms to an hour"),
    ],
)
def test_what_is_refused_is_logged_with_its_limit(
    guarded: Guarded, caplog: pytest.LogCaptureFixture, name: str, parameters: object, words: str
) -> None:
    for _ in range(2):
        guarded.ask(name, parameters)
    assert caplog.messages == [f"OPC UA server: 1 requests refused: {words}"]


def test_items_are_counted_until_they_or_their_subscription_are_gone(guarded: Guarded) -> None:
    guarded.create(7, *[True] * 1200, False)
    guarded.create(7, *[True] * 400)
    guarded.create(8, *[True] * 300)
    assert [guarded.ask("CreateMonitoredItems", items(7, count)) for count in (100, 101)] == [
        *("", "BadTooManyMonitoredItems")
    ]
    guarded.delete(7, True, False, True)
    assert [guarded.ask("CreateMonitoredItems", items(7, count)) for count in (102, 103)] == [
        *("", "BadTooManyMonitoredItems")
    ]
    del guarded.subscriptions[8]
    assert [guarded.ask("CreateMonitoredItems", items(7, count)) for count in (402, 403)] == [
        *("", "BadTooManyMonitoredItems")
    ]


def test_who_listens_is_told_of_items_that_were_created(guarded: Guarded) -> None:
    told = list[Callback]()
    guarded.door.created.add(told.append)
    guarded.create(7, True)
    guarded.delete(7, True)
    assert [event.request_params.SubscriptionId for event in told] == [7]


def test_clients_are_told_the_limits_beforehand(guarded: Guarded) -> None:
    names = ("Read", "Browse", "TranslateBrowsePathsToNodeIds")
    limits = {f"MaxNodesPer{name}": limit for name, limit in zip(names, (500, 20, 20), strict=True)}
    of_nodes = {
        getattr(ua.ObjectIds, f"Server_ServerCapabilities_OperationLimits_{name}"): limit
        for name, limit in (limits | {"MaxMonitoredItemsPerCall": 500}).items()
    }
    assert guarded.nodes.written == of_nodes
    assert guarded.nodes.limits.max_message_size == 2**20


@pytest.mark.promise("docs/how-to/opcua.md", "at most 100 values of a variable wait for a client.")
def test_the_sessions_are_bounded(guarded: Guarded) -> None:
    one = guarded.sessions
    assert (one.max_connections, one.max_subscriptions, one.max_pending_activation_seconds) == (64, 128, 10.0)
    assert (one.max_monitored_item_queue_size, one.max_unacked_messages_per_subscription) == (100, 100)
    assert (one.max_keep_alive_count, one.max_lifetime_count) == (100, 1000)


def test_a_subscription_without_a_session_that_is_there_ends(guarded: Guarded) -> None:
    ended = list[int]()

    async def end(numbers: list[int]) -> None:
        ended.extend(numbers)

    guarded.sessions.subscription_service.delete_subscriptions = end
    guarded.held[0].state = SessionState.Activated  # the other one has never shown who it is
    asyncio.run(guarded.sessions.end_orphans())
    assert ended == [8]
    guarded.held[1].state = SessionState.Activated
    asyncio.run(guarded.sessions.end_orphans())
    assert ended == [8]


def test_a_session_ends_with_its_connection_and_takes_no_server_of_others(guarded: Guarded) -> None:
    assert [session.external for session in guarded.held] == [False, False]
    with pytest.raises(ServiceError) as caught:
        guarded.sessions.register_server(ua.RegisteredServer("urn:other"))
    assert caught.value.code == ua.StatusCodes.BadServiceUnsupported


@pytest.mark.parametrize(
    ("has_password", "token"), [(True, ua.UserNameIdentityToken), (False, ua.AnonymousIdentityToken)]
)
def test_clients_are_asked_for_a_user_only_if_there_is_one(guarded: Guarded, has_password: bool, token: type) -> None:
    clients = Clients("scada", "a password" if has_password else None, None, are_encrypted=False)
    server = Server(iserver=guarded.sessions)
    asyncio.run(Security(clients, has_password, False, None).apply(server, guarded.door))
    assert guarded.sessions.supported_tokens == (token,)


@pytest.mark.parametrize(
    ("name", "password", "is_user"),
    [
        ("scada", "a password", True),
        ("scada", "another", False),
        ("admin", "a password", False),
        (None, "scada\na password", False),
        ("scada", None, False),
    ],
)
def test_only_who_has_both_the_name_and_the_password_is_the_user(
    name: str | None, password: str | None, is_user: bool
) -> None:
    clients = Clients("scada", "a password", None, are_encrypted=False)
    user = clients.get_user(None, name, password)
    assert (user.role if user else None) == (UserRole.User if is_user else None)


def test_without_a_password_everybody_is_the_user_but_not_without_encryption_where_there_is_a_certificate() -> None:
    user = Clients(None, None, None, are_encrypted=False).get_user(None)
    assert user is not None
    assert user.role is UserRole.User
    encrypted = Clients(None, None, None, are_encrypted=True)
    assert encrypted.get_user(None, certificate=b"any") is not None
    for certificate in (None, b""):
        with pytest.raises(ServiceError) as caught:
            encrypted.get_user(None, certificate=certificate)
        assert caught.value.code == ua.StatusCodes.BadSecurityModeRejected
