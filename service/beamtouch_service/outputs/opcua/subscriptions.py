"""Subscriptions without deadbands: a filter with one is refused.

The library compares numbers where a value is missing, and passes over the error: behind a deadband, a client would
never hear that a contact ended or that its samples stopped, nor that a value became doubtful.
"""

from dataclasses import replace

from asyncua import ua
from asyncua.server.subscription_service import SubscriptionService

REFUSED = ua.StatusCode(ua.StatusCodes.BadMonitoredItemFilterUnsupported)


class ExactSubscriptions(SubscriptionService):  # type: ignore[misc]  # mypy skips the types of the library
    """The subscriptions of a server, which report each change."""

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
        exact = [item for item in params.ItemsToModify if not _has_deadband(item)]
        modified = iter(super().modify_monitored_items(replace(params, ItemsToModify=exact)))
        return [
            ua.MonitoredItemModifyResult(REFUSED) if _has_deadband(item) else next(modified)
            for item in params.ItemsToModify
        ]


def _has_deadband(item: ua.MonitoredItemCreateRequest | ua.MonitoredItemModifyRequest) -> bool:
    # By its member: the library reads a filter of a client as another class than `ua.DataChangeFilter`.
    none = ua.DeadbandType.None_
    return bool(getattr(item.RequestedParameters.Filter, "DeadbandType", none) != none)
