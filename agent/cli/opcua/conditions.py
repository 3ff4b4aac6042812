"""Alarms as conditions: a node for each activation not back to normal, and an event for each of its steps."""

from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from asyncua import ua
from asyncua.common.events import get_event_obj_from_type_node

from agent.cli.opcua.alarm_fields import event_id, fields_of
from agent.cli.opcua.space import Space
from agent.cli.tuning import NORMAL_KEPT

Row = Mapping[str, Any]
Method = Callable[..., Awaitable[Any]]
_STATES: Final = ("ConfirmedState", "SuppressedState", "OutOfServiceState")
ADDED: Final = ("Confirm", "RemoveFromService", "PlaceInService")
"""Methods that the type leaves open."""


@dataclass(slots=True)
class Condition:
    """One activation of an alarm: its database, newest row, newest event's id, node and event."""

    db: str
    alarm: Row
    node: Any
    rig: Any
    event: Any
    step: bytes = b""


@dataclass(slots=True)
class Conditions:
    """The alarms of all databases, by the name of their nodes.

    Attributes:
        space: where rigs and parameters are.
        methods: what is called on a condition, by names such as "Acknowledge" and
            "ShelvingState.TimedShelve".
    """

    space: Space
    methods: Mapping[str, Method] = field(default_factory=dict)
    _by_name: OrderedDict[str, Condition] = field(default_factory=OrderedDict)

    def find(self, node_id: Any) -> Condition | None:
        """Return the condition that a method was called on: on its node, or on its shelving state."""
        return self._by_name.get(str(node_id.Identifier).removesuffix(".ShelvingState"))

    async def step(self, db: str, alarm: Row, step: Row) -> None:
        """Take in an alarm's step (`id`, `t_ns`, `by`, `comment`): write its node, tell whoever listens."""
        name = f"{db}/alarm {alarm['id']}"
        found = self._by_name.get(name)
        if found is None:
            found = self._by_name[name] = await self._made(name, db, alarm)
        self._by_name.move_to_end(name)
        found.alarm = alarm
        found.step = event_id(db, alarm, step["id"])
        fields = fields_of(alarm, {**step, "event_id": found.step}, self._places(found))
        await self._write(name, fields)
        await self._say(found, fields)
        await self._forget()

    def _places(self, found: Condition) -> dict[str, Any]:
        """Return where a condition belongs: to the parameter that it is of, else to the rig."""
        alarm = found.alarm
        parameter = self.space.parameter(found.db, alarm["rig"], alarm["parameter"])
        return {
            "source": found.rig.nodeid if parameter is None else parameter, "input": parameter or ua.NodeId(),
            "name": f"{alarm['rig']} {alarm['parameter']}",
        }  # fmt: skip

    async def _made(self, name: str, db: str, alarm: Row) -> Condition:
        server = self.space.server
        rig = await self.space.rig(db, alarm["rig"])
        of_type = ua.NodeId(ua.ObjectIds.AlarmConditionType)
        shown = f"{self.space.index}:{alarm['kind']} {alarm['parameter']} {alarm['id']}"
        node = await rig.add_object(
            self.space.node_id(name), shown, objecttype=of_type, instantiate_optional=False
        )
        await self._add_optional(node, name)
        for method in self.methods:
            if method not in ADDED:
                server.link_method(
                    server.get_node(self.space.node_id(f"{name}.{method}")), self.methods[method]
                )
        event = await get_event_obj_from_type_node(server.get_node(of_type))
        event.add_property("NodeId", node.nodeid, ua.VariantType.NodeId)
        return Condition(db, alarm, node, rig, event)

    async def _add_optional(self, node: Any, name: str) -> None:
        """Add what the type leaves open: further states, shelving, confirming, out of service."""
        for state in _STATES:
            words = await node.add_variable(
                self.space.node_id(f"{name}.{state}"),
                f"0:{state}",
                ua.LocalizedText(""),
                ua.VariantType.LocalizedText,
            )
            await words.add_property(self.space.node_id(f"{name}.{state}.Id"), "0:Id", val=False)
        limit = self.space.node_id(f"{name}.MaxTimeShelved")
        await node.add_property(limit, "0:MaxTimeShelved", 0.0, datatype=ua.NodeId(ua.ObjectIds.Duration))
        shelving = ua.NodeId(ua.ObjectIds.ShelvedStateMachineType)
        await node.add_object(
            self.space.node_id(f"{name}.ShelvingState"),
            "0:ShelvingState",
            shelving,
            instantiate_optional=False,
        )
        said = [
            _argument("EventId", ua.ObjectIds.ByteString),
            _argument("Comment", ua.ObjectIds.LocalizedText),
        ]
        for method in ADDED:
            inputs = said if method == "Confirm" else []
            place = self.space.node_id(f"{name}.{method}")
            await node.add_method(place, f"0:{method}", self.methods[method], inputs, [])

    async def _write(self, name: str, fields: Mapping[str, Any]) -> None:
        """Write the variables of a condition's node, of those fields that it has."""
        server = self.space.server
        for place, value in fields.items():
            node_id = self.space.node_id(f"{name}.{place.replace('/', '.')}")
            if node_id in server.iserver.aspace:
                await server.write_attribute_value(node_id, ua.DataValue(value))

    async def _say(self, found: Condition, fields: Mapping[str, Any]) -> None:
        """Send the event to listeners at the rig and at the server; that one is what a refresh repeats."""
        for name, value in fields.items():
            found.event.add_property(name, value.Value, value.VariantType)
        for emitting in (found.rig.nodeid, ua.NodeId(ua.ObjectIds.Server)):
            found.event.emitting_node = emitting
            await self.space.server.iserver.subscription_service.trigger_event(found.event)

    async def _forget(self) -> None:
        """Remove the nodes of the alarms that have been back to normal for longest."""
        normal = [name for name, found in self._by_name.items() if found.alarm["state"] == "NORM"]
        for name in normal[: max(0, len(normal) - NORMAL_KEPT)]:
            await self.space.server.delete_nodes([self._by_name.pop(name).node], recursive=True)


def _argument(name: str, of_type: int) -> Any:
    return ua.Argument(Name=name, DataType=ua.NodeId(of_type), ValueRank=-1)
