"""The sessions of the OPC UA server, and the door before them: what a request of a client may ask for.

The library asks a set of permissions before each request of a session, and takes a server of sessions from its caller.
All that this server refuses or bounds is here and in the library's own limits.
"""

import logging
from collections.abc import Callable, Collection, Iterable
from typing import Any
from weakref import WeakSet

from asyncua import Server, ua
from asyncua.common.callback import Callback, CallbackType
from asyncua.common.utils import Buffer, ServiceError
from asyncua.crypto.permission_rules import PermissionRuleset, User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager
from asyncua.ua.ua_binary import struct_from_binary

from beamtouch_common.log_lines import Repeated
from beamtouch_service.outputs.opcua.turns import Transports
from beamtouch_service.surfaces.listeners import Listeners

MAX_CONNECTIONS = 64
MAX_SUBSCRIPTIONS = 128
"""Of all clients."""
MAX_ITEMS = 2000
"""Subscribed variables and sources of events of all clients. While the subscribers of one surface are told, the service
does nothing else: with so many, some 40 ms."""
MAX_WAITING = 100
"""Values of a variable, events, and messages without acknowledgement that are kept for a subscription."""
MAX_OPERATIONS, MAX_BROWSED, MAX_ELEMENTS = 500, 20, 200
"""Nodes or items in one request, nodes to browse or paths to follow, and elements of all its paths. While it is
answered, nothing else of the service is: a node to browse takes 3 ms, one to read 35 us, and a new item 100 us."""
MAX_PENDING = 100
"""Messages of one connection that wait for their turn."""
MAX_MESSAGE_BYTES = 1 << 20
MIN_INTERVAL_MS, MAX_INTERVAL_MS = 10.0, 3_600_000.0
"""Publishing intervals that are taken. With one of a microsecond, the service would do nothing else."""
MAX_KEEP_ALIVE, MAX_LIFETIME = 100, 1000
"""Publishing intervals until a client hears that nothing is new, and until one that hangs loses its subscription."""
ACTIVATION_S = 10.0
"""Time in which a connection must show who it is."""

NOBODY = User(role=UserRole.Anonymous)
_OPERATION_LIMITS = {
    "MaxNodesPerRead": MAX_OPERATIONS,
    "MaxMonitoredItemsPerCall": MAX_OPERATIONS,
    "MaxNodesPerBrowse": MAX_BROWSED,
    "MaxNodesPerTranslateBrowsePathsToNodeIds": MAX_BROWSED,
}
_log = logging.getLogger(__name__)


class Sessions(InternalServer):  # type: ignore[misc]  # mypy skips the types of the library
    """The sessions of a server. Each ends with its connection, and clients register no other servers.

    The library keeps a session for minutes after its connection was lost, and gives it to whoever names its number,
    which is easily guessed, before it has seen who asks. It takes other servers into its list from anyone.
    """

    def __init__(self, users: UserManager) -> None:
        super().__init__(user_manager=users)
        self._sessions: WeakSet[InternalSession] = WeakSet()
        self.max_connections, self.max_subscriptions = MAX_CONNECTIONS, MAX_SUBSCRIPTIONS
        self.max_monitored_item_queue_size = self.max_unacked_messages_per_subscription = MAX_WAITING
        self.max_keep_alive_count, self.max_lifetime_count = MAX_KEEP_ALIVE, MAX_LIFETIME
        self.max_pending_activation_seconds = ACTIVATION_S
        self.asyncio_transports: Transports = Transports(MAX_PENDING)

    def create_session(self, name: str, user: User = NOBODY, external: bool = False) -> InternalSession:
        """Begin a session that no other connection can use."""
        del external
        session = super().create_session(name, user, external=False)
        self._sessions.add(session)
        return session

    def register_server(self, server: object, conf: object = None) -> None:
        """Refuse to take a server into that list."""
        del server, conf
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    def owns(self, user: User, subscription: int) -> bool:
        """Return whether a subscription is of the session of this user; each session has a user object of its own."""
        found = self.subscription_service.subscriptions.get(subscription)
        return found is not None and any(
            session.user is user and session.session_id == found.session_id for session in self._sessions
        )

    async def end_orphans(self) -> None:
        """End the subscriptions that a client has left to others at the end of its session."""
        alive = [session.session_id for session in self._sessions if session.is_activated()]
        every = self.subscription_service.subscriptions.items()
        if orphans := [number for number, one in every if one.session_id not in alive]:
            await self.subscription_service.delete_subscriptions(orphans)


class Door(PermissionRuleset):  # type: ignore[misc]  # mypy skips the types of the library
    """Lets requests pass that read, and change nothing but what their own session has subscribed to."""

    def __init__(self, sessions: Sessions) -> None:
        self._sessions = sessions
        self._items: dict[int, int] = {}
        """Subscription -> its items."""
        self.created: Listeners[Callback] = Listeners()
        """Told of each request by which clients subscribed to variables or events. The library tells only one."""
        self._repeated = Repeated(_log, "OPC UA server")
        checks: dict[str, tuple[type | None, Callable[[User, Any], None] | None]] = {
            "Publish": (None, None),
            "CloseSecureChannel": (None, None),
            "ModifySubscription": (None, None),  # the library changes nothing, and says what is
            "RegisterNodes": (None, None),
            "UnregisterNodes": (None, None),
            "Write": (None, self._deny),
            "Read": (ua.ReadParameters, lambda _, asked: self._count(asked.NodesToRead, MAX_OPERATIONS)),
            "Browse": (ua.BrowseParameters, lambda _, asked: self._count(asked.NodesToBrowse, MAX_BROWSED)),
            "TranslateBrowsePathsToNodeIds": (
                ua.TranslateBrowsePathsToNodeIdsParameters,
                self._check_paths,
            ),
            "CreateSubscription": (ua.CreateSubscriptionParameters, self._check_interval),
            "CreateMonitoredItems": (ua.CreateMonitoredItemsParameters, self._check_items),
            "DeleteMonitoredItems": (ua.DeleteMonitoredItemsParameters, self._require_own),
            "SetMonitoringMode": (ua.SetMonitoringModeParameters, self._require_own),
            "Republish": (ua.RepublishParameters, self._require_own),
            "DeleteSubscriptions": (ua.DeleteSubscriptionsParameters, self._require_all_own),
            "SetPublishingMode": (ua.SetPublishingModeParameters, self._require_all_own),
        }
        ids = vars(ua.ObjectIds)
        self._checks = {ua.NodeId(ids[f"{name}Request_Encoding_DefaultBinary"]): one for name, one in checks.items()}

    async def guard(self, server: Server) -> None:
        """Stand before the sessions of a server that does not listen yet, and say what its clients may ask for."""
        server.limits.max_message_size = MAX_MESSAGE_BYTES
        for name, limit in _OPERATION_LIMITS.items():
            number = getattr(ua.ObjectIds, f"Server_ServerCapabilities_OperationLimits_{name}")
            await server.get_node(ua.NodeId(number)).write_value(limit, ua.VariantType.UInt32)
        server.subscribe_server_callback(CallbackType.ItemSubscriptionCreated, self._note_created)
        server.subscribe_server_callback(CallbackType.ItemSubscriptionDeleted, self._note_deleted)

    def check_validity(self, user: User, action_type: ua.NodeId, body: Buffer) -> bool:
        """Return True if a request may pass; raises ServiceError with the reason if not.

        Among what no client may ask for is the transfer of subscriptions. After a restart of the service, a client that
        asks for those that it had would take, by their numbers, those of others.
        """
        if action_type not in self._checks:
            raise ServiceError(ua.StatusCodes.BadServiceUnsupported)
        parameters, check = self._checks[action_type]
        if check:
            check(user, parameters and struct_from_binary(parameters, body.copy()))
        return True

    def _count(self, asked: Collection[object], limit: int) -> None:
        if len(asked) > limit:
            self._refuse("BadTooManyOperations", f"more than {limit} nodes in one request")

    def _check_paths(self, _user: User, asked: ua.TranslateBrowsePathsToNodeIdsParameters) -> None:
        self._count(asked.BrowsePaths, MAX_BROWSED)
        lengths = [len(path.RelativePath.Elements) for path in asked.BrowsePaths]
        if sum(lengths) > MAX_ELEMENTS:
            self._refuse("BadTooManyOperations", f"more than {MAX_ELEMENTS} elements of paths in one request")
        if 0 in lengths:  # an error of the library
            self._refuse("BadNothingToDo", "a path without an element")

    def _check_interval(self, _user: User, asked: ua.CreateSubscriptionParameters) -> None:
        # In this order, NaN is refused.
        if not MIN_INTERVAL_MS <= asked.RequestedPublishingInterval <= MAX_INTERVAL_MS:
            words = f"a publishing interval of {asked.RequestedPublishingInterval:g} ms, not of 10 ms to an hour"
            self._refuse("BadInvalidArgument", words)

    def _check_items(self, user: User, asked: ua.CreateMonitoredItemsParameters) -> None:
        self._require_own(user, asked)
        self._count(asked.ItemsToCreate, MAX_OPERATIONS)
        if any(_is_filtered(item.RequestedParameters.Filter) for item in asked.ItemsToCreate):
            words = "a filter with a deadband or for timestamps, which would hide changes"
            self._refuse("BadMonitoredItemFilterUnsupported", words)
        subscriptions = self._sessions.subscription_service.subscriptions
        self._items = {number: count for number, count in self._items.items() if number in subscriptions}
        if sum(self._items.values()) + len(asked.ItemsToCreate) > MAX_ITEMS:
            self._refuse("BadTooManyMonitoredItems", f"more than {MAX_ITEMS} items of all subscriptions")

    def _require_own(self, user: User, asked: Any) -> None:  # noqa: ANN401  # one of several types of the library
        self._require(user, [asked.SubscriptionId])

    def _require_all_own(self, user: User, asked: Any) -> None:  # noqa: ANN401  # one of several types of the library
        self._require(user, asked.SubscriptionIds)

    def _require(self, user: User, subscriptions: Iterable[int]) -> None:
        if not all(self._sessions.owns(user, number) for number in subscriptions):
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)

    def _deny(self, _user: User, _asked: None) -> None:
        raise ServiceError(ua.StatusCodes.BadUserAccessDenied)

    def _refuse(self, code: str, words: str) -> None:
        self._repeated.count(1, f"requests refused: {words}")
        raise ServiceError(getattr(ua.StatusCodes, code))

    def _note_created(self, event: Callback, _service: object) -> None:
        self._note(event, sum(result.StatusCode.is_good() for result in event.response_params))
        self.created.tell(event)

    def _note_deleted(self, event: Callback, _service: object) -> None:
        self._note(event, -sum(code.is_good() for code in event.response_params))

    def _note(self, event: Callback, items: int) -> None:
        number = event.request_params.SubscriptionId
        self._items[number] = self._items.get(number, 0) + items


def _is_filtered(wanted: object) -> bool:
    """Return whether a filter passes over some changes of value or status, or reports what is none.

    With a deadband, the library compares numbers where a value is missing, and passes over the error: a client would
    never hear that a contact ended or that its samples stopped, nor that a value became doubtful.
    """
    # By its members: the library reads a filter of a client as another class than `ua.DataChangeFilter`.
    deadband = getattr(wanted, "DeadbandType", ua.DeadbandType.None_)
    trigger = getattr(wanted, "Trigger", ua.DataChangeTrigger.StatusValue)
    return bool(deadband != ua.DeadbandType.None_ or trigger == ua.DataChangeTrigger.StatusValueTimestamp)
