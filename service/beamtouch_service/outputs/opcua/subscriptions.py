"""Subscriptions without deadbands, and not faster than their variables are looked at.

A filter with a deadband is refused. The library compares numbers where a value is missing, and passes over the error:
behind a deadband, a client would never hear that a contact ended or that its samples stopped, nor that a value became
doubtful.

The library takes any publishing interval. With one of a microsecond, it would do nothing else; with 0, by which a
client asks for the shortest one, it never says that it is still there.

It lets a session end, change and take over the subscriptions of every other one. Here each session has its own.
"""

from collections.abc import Callable, Iterator, MutableMapping
from dataclasses import replace
from typing import Any

from asyncua import ua
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.subscription_service import SubscriptionService

MOST_WAITING = 100
"""Values of a variable, events, and messages without acknowledgement that are kept for a subscription. The library
would keep 10 000 for a client that hangs: 44 MB of values, and as many notifications for each such client."""
REFUSED = ua.StatusCode(ua.StatusCodes.BadMonitoredItemFilterUnsupported)


class ExactSubscriptions(SubscriptionService):  # type: ignore[misc]  # mypy skips the types of the library
    """The subscriptions of a server, which report each change."""

    def __init__(self, server: InternalServer, interval_ms: float) -> None:
        """Variables are looked at every `interval_ms`."""
        super().__init__(server.aspace, server)
        server.max_monitored_item_queue_size = server.max_unacked_messages_per_subscription = MOST_WAITING
        self.interval_ms = interval_ms

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        session_id: ua.NodeId,
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription; returns its publishing interval, which is at least that of the looks."""
        # In this order, the interval of the looks counts where that of the client is no number.
        interval_ms = max(self.interval_ms, params.RequestedPublishingInterval)
        revised = replace(params, RequestedPublishingInterval=interval_ms)
        return await super().create_subscription(revised, callback, session_id, request_callback)

    async def create_monitored_items(
        self, params: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """Create those items that ask for no deadband; returns a result for each."""
        exact = [item for item in params.ItemsToCreate if not _has_deadband(item)]
        created = iter(await super().create_monitored_items(replace(params, ItemsToCreate=exact)))
        return [
            ua.MonitoredItemCreateResult(REFUSED) if _has_deadband(item) else next(created)
            for item in params.ItemsToCreate
        ]

    def modify_monitored_items(self, params: ua.ModifyMonitoredItemsParameters) -> list[ua.MonitoredItemModifyResult]:
        """Modify those items that ask for no deadband; returns a result for each. The others stay as they were."""
        exact = [_bounded(item) for item in params.ItemsToModify if not _has_deadband(item)]
        modified = iter(super().modify_monitored_items(replace(params, ItemsToModify=exact)))
        return [
            ua.MonitoredItemModifyResult(REFUSED) if _has_deadband(item) else next(modified)
            for item in params.ItemsToModify
        ]


class OwnSubscriptions(ExactSubscriptions):
    """The subscriptions of a server as far as one session reaches: its own."""

    def __init__(self, every: ExactSubscriptions, session_id: ua.NodeId) -> None:
        super().__init__(every.iserver, every.interval_ms)
        self._every = every
        self.subscriptions = _Own(every.subscriptions, session_id)

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        session_id: ua.NodeId,
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription among those of all, which are numbered together."""
        return await self._every.create_subscription(params, callback, session_id, request_callback)


class _Own(MutableMapping[int, InternalSubscription]):
    """Those of all subscriptions, by number, that belong to a session."""

    def __init__(self, every: dict[int, InternalSubscription], session_id: ua.NodeId) -> None:
        self._every, self._session_id = every, session_id

    def __getitem__(self, number: int) -> InternalSubscription:
        found = self._every[number]
        if found.session_id != self._session_id:
            raise KeyError(number)
        return found

    def __setitem__(self, number: int, subscription: InternalSubscription) -> None:
        self._every[number] = subscription

    def __delitem__(self, number: int) -> None:
        del self._every[self[number].data.SubscriptionId]

    def __iter__(self) -> Iterator[int]:
        return (number for number, one in list(self._every.items()) if one.session_id == self._session_id)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _bounded(item: ua.MonitoredItemModifyRequest) -> ua.MonitoredItemModifyRequest:
    """Return an item with a queue as long as that of a new one at most; the library takes any length here."""
    asked = item.RequestedParameters
    length = min(max(asked.QueueSize, 1), MOST_WAITING)
    return replace(item, RequestedParameters=replace(asked, QueueSize=length))


def _has_deadband(item: ua.MonitoredItemCreateRequest | ua.MonitoredItemModifyRequest) -> bool:
    # By its member: the library reads a filter of a client as another class than `ua.DataChangeFilter`.
    none = ua.DeadbandType.None_
    return bool(getattr(item.RequestedParameters.Filter, "DeadbandType", none) != none)
