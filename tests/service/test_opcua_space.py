"""What readers and subscribers of OPC UA get, and when: of a server that notes what it is told."""

import asyncio
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest
from asyncua import ua

from beamtouch_common.zones import Zone
from beamtouch_service.outputs.opcua.space import OtherAxesError, Space
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from service.bench import Bench, Row, parsed, surface_of
from service.event_story import RESTING, TOUCHING

INDEX = 7
Reader = Callable[[ua.NodeId, ua.AttributeIds], ua.DataValue]


class Noting:
    """What a space needs of a server and its nodes."""

    def __init__(self) -> None:
        self.objects: list[str] = []
        self.kinds: dict[str, ua.NodeId] = {}
        self.texts: dict[str, str] = {}
        self.readers: dict[str, Reader] = {}
        self.setters: dict[str, Callable[..., object]] = {}
        self.told: list[tuple[str, object]] = []
        """Variable and value that subscribers were told."""
        self.subscriptions = {1: "one"}
        self.iserver = SimpleNamespace(subscription_service=SimpleNamespace(subscriptions=self.subscriptions))

    async def register_namespace(self, name: str) -> int:
        assert name == "urn:beamtouch"
        return INDEX

    def get_objects_node(self) -> SimpleNamespace:
        async def add_object(nodeid: ua.NodeId, name: ua.QualifiedName) -> SimpleNamespace:
            assert (nodeid.NamespaceIndex, name.NamespaceIndex, name.Name) == (INDEX, INDEX, nodeid.Identifier)
            self.objects.append(name.Name)
            return SimpleNamespace(nodeid=nodeid, add_variable=self.add_variable)

        return SimpleNamespace(add_object=add_object)

    async def add_variable(
        self, nodeid: ua.NodeId, name: ua.QualifiedName, value: ua.Variant, datatype: ua.NodeId
    ) -> SimpleNamespace:
        path = str(nodeid.Identifier)
        assert path.partition("/")[2] == name.Name
        assert (nodeid.NamespaceIndex, name.NamespaceIndex, value.Value) == (INDEX, INDEX, None)
        self.kinds[path] = datatype

        async def write(attribute: ua.AttributeIds, text: ua.DataValue) -> None:
            assert attribute is ua.AttributeIds.Description
            self.texts[path] = text.Value.Value.Text

        return SimpleNamespace(write_attribute=write)

    def set_attribute_value_callback(self, nodeid: ua.NodeId, read: Reader) -> None:
        self.readers[nodeid.Identifier] = read

    def set_attribute_value_setter(self, nodeid: ua.NodeId, setter: Callable[..., object]) -> None:
        self.setters[nodeid.Identifier] = setter

    async def write_attribute_value(self, nodeid: ua.NodeId, value: ua.DataValue) -> None:
        self.told.append((nodeid.Identifier, value.Value.Value))

    def read(self, name: str) -> object:
        nodeid = ua.NodeId(name, INDEX)
        value = self.readers[name](nodeid, ua.AttributeIds.Value)
        return value.Value.Value if value.StatusCode.is_good() else value.StatusCode.name


class Plant:
    """A bench with a space for its surfaces."""

    def __init__(self, *surfaces: Surface) -> None:
        self.bench, self.server, self.sequence = Bench(*surfaces), Noting(), 0
        self.space = Space(cast("Any", self.server), self.bench.app.context)

    def receive(self, surface: Surface, row: Row) -> None:
        self.sequence += 1
        self.bench.now_s += 1e-3
        surface.receive(parsed(row, sequence=self.sequence), self.bench.now_s)

    def subscribe(self, *names: str) -> None:
        items = [SimpleNamespace(ItemToMonitor=SimpleNamespace(NodeId=ua.NodeId(name, INDEX))) for name in names]
        asked = SimpleNamespace(request_params=SimpleNamespace(ItemsToCreate=items))
        self.space.note_subscription(cast("Any", asked))

    def told(self, name: str) -> list[object]:
        return [value for path, value in self.server.told if path == name]

    async def settle(self) -> None:
        """Give others their turns, until nobody tells anything more."""
        for _ in range(50):
            await asyncio.sleep(0)

    def run(self, play: Callable[[], Awaitable[None]]) -> None:
        """Play while subscribers are followed, in turns of half a second."""

        async def run() -> None:
            await self.space.build()
            following = asyncio.ensure_future(self.space.follow(0.5))
            await play()
            following.cancel()

        asyncio.run(run())


def test_each_surface_is_an_object_with_variables_that_say_what_they_are() -> None:
    zones = SurfaceSection(zones={"gate": Zone(from_mm=120, to_mm=200)})
    plant = Plant(surface_of("press-7"), surface_of("press-8", section=zones))
    asyncio.run(plant.space.build())
    server = plant.server
    assert server.objects == ["press-7", "press-8"]
    assert {name: node.Identifier for name, node in plant.space.objects.items()} == {one: one for one in server.objects}
    assert plant.space.axes == {"press-7": ("position",), "press-8": ("position",)}
    of_second = {name.partition("/")[2] for name in server.kinds if name.startswith("press-8/")}
    of_first = {name.partition("/")[2] for name in server.kinds if name.startswith("press-7/")}
    assert of_second == of_first | {"zones/gate"}
    kinds = {name: server.kinds[f"press-7/{name}"].Identifier for name in ("position_mm", "state", "sequence")}
    assert kinds == {
        "position_mm": ua.ObjectIds.Double,
        "state": ua.ObjectIds.String,
        "sequence": ua.ObjectIds.UInt64,
    }
    assert server.texts["press-7/position_mm"].endswith("[mm]")
    assert server.texts["press-8/zones/gate"].startswith("inside, outside or unsure")
    # What subscribers are told is not stored: the next read has the contact of its moment.
    assert {setter(None, None, None) for setter in server.setters.values()} == {None}
    assert server.setters.keys() == server.readers.keys() == server.kinds.keys()


@pytest.mark.promise("docs/how-to/opcua.md", "Variables of one surface that are read together belong to one sample.")
def test_all_that_is_read_in_one_turn_of_the_loop_is_of_one_sample() -> None:
    surface = surface_of()
    plant = Plant(surface)

    async def read() -> None:
        await plant.space.build()
        plant.receive(surface, TOUCHING)
        before = plant.server.read("press-7/sequence")
        plant.receive(surface, TOUCHING)
        assert [before, plant.server.read("press-7/sequence")] == [1, 1]
        await asyncio.sleep(0)
        assert plant.server.read("press-7/sequence") == 2

    asyncio.run(read())


def test_subscribers_are_told_what_has_changed_and_no_more() -> None:
    surface, other = surface_of(), surface_of("press-8")
    plant = Plant(surface, other)

    async def play() -> None:
        plant.receive(surface, RESTING)
        await plant.settle()
        assert plant.server.told == []  # nobody has subscribed
        plant.subscribe("press-7/state", "press-7/sequence", "no-such/state")
        await plant.settle()
        assert (plant.told("press-7/state"), plant.told("press-7/sequence")) == (["clear"], [1])
        for row in (RESTING, TOUCHING):
            plant.bench.now_s += 1.0
            plant.receive(surface, row)
            await plant.settle()
        assert (plant.told("press-7/state"), plant.told("press-7/sequence")) == (["clear", "contact"], [1, 2, 3])
        assert not plant.told("press-8/state")
        plant.subscribe("press-8/state")
        await plant.settle()
        assert plant.told("press-8/state") == [None]

    plant.run(play)


def test_who_has_read_another_value_meanwhile_is_told_of_the_one_that_the_others_have() -> None:
    surface = surface_of()
    plant = Plant(surface)

    async def play() -> None:
        plant.receive(surface, RESTING)
        plant.subscribe("press-7/state")
        await plant.settle()
        assert plant.told("press-7/state") == ["clear"]
        # Within one turn of the pace, the state changes and comes back. In between, somebody sees it.
        plant.receive(surface, TOUCHING)
        assert plant.server.read("press-7/state") == "contact"
        await asyncio.sleep(0)
        plant.receive(surface, RESTING)
        plant.bench.now_s += 1.0
        plant.receive(surface, RESTING)
        await plant.settle()
        assert plant.told("press-7/state") == ["clear", "clear"]

    plant.run(play)


def test_without_subscribers_nobody_is_told_until_one_comes_again() -> None:
    surface = surface_of()
    plant = Plant(surface)

    async def play() -> None:
        plant.receive(surface, RESTING)
        plant.subscribe("press-7/state")
        await plant.settle()
        plant.server.subscriptions.clear()
        for _ in range(3):
            plant.bench.now_s += 1.0
            plant.receive(surface, RESTING)
            await plant.settle()
        assert plant.told("press-7/sequence") == [1]
        plant.server.subscriptions[2] = "two"
        plant.subscribe("press-7/state")
        await plant.settle()
        assert plant.told("press-7/sequence") == [1, 4]

    plant.run(play)


def test_other_axes_end_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = surface_of()
    plant = Plant(surface)

    async def look() -> None:
        await plant.space.build()
        monkeypatch.setattr("beamtouch_service.outputs.opcua.space.LOOK_S", 0.0)
        looking = asyncio.ensure_future(plant.space.require_same_axes())
        await plant.settle()
        assert not looking.done()
        plant.space.axes["press-7"] = ("x", "y")
        with pytest.raises(OtherAxesError):
            await looking

    asyncio.run(look())
