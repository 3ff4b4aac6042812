"""The address space: databases, their rigs, and each parameter as a variable with its interval beside it."""

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any, Final, NamedTuple

from asyncua import ua

from agent.cli.opcua.quality import own_code, quality_of

Row = Mapping[str, Any]
NAMESPACE: Final = "urn:deltak:rigs"
FIGURES: Final[Mapping[str, str]] = {
    "lower": "Lower", "upper": "Upper", "sd": "Sd", "delta": "Delta", "reference": "Reference",
    "limit": "Limit", "window_s": "WindowSeconds",
}  # fmt: skip
"""What stands beside a parameter, by column of the overview: numbers of the newest window."""
TEXTS: Final[Mapping[str, str]] = {"status": "Status", "reason": "Reason"}


class Key(NamedTuple):
    """One parameter of one rig of one database."""

    db: str
    rig: str
    parameter: str


class Space:
    """The nodes of rigs and parameters, made as they appear; they stay, with what was known of them last.

    Args:
        server: the asyncua server, set up and not started yet, or running.
        index: of the namespace that all nodes are in.
    """

    def __init__(self, server: Any, index: int) -> None:
        self.server, self.index = server, index
        self._root: Any = None
        self._rigs: dict[tuple[str, str], Any] = {}
        self._parameters: set[Key] = set()
        self._written: dict[Any, Any] = {}

    def node_id(self, *parts: str) -> Any:
        """Return the id of what is called so: its parts, joined by slashes."""
        return ua.NodeId("/".join(parts), self.index)

    async def rig(self, db: str, name: str) -> Any:
        """Return the node of a rig, from which its alarms come; it is made where it is not there yet."""
        if (db, name) not in self._rigs:
            self._rigs[db, name] = await self._made_rig(db, name)
        return self._rigs[db, name]

    async def _made_rig(self, db: str, name: str) -> Any:
        if self._root is None:
            objects = self.server.nodes.objects
            self._root = await objects.add_folder(self.node_id("deltak"), f"{self.index}:deltak")
        node = await self._root.add_object(self.node_id(db, name), f"{self.index}:{name}")
        await node.set_event_notifier([ua.EventNotifier.SubscribeToEvents])
        await self.server.nodes.server.add_reference(node, ua.ObjectIds.HasNotifier)
        return node

    def parameter(self, db: str, rig: str, parameter: str) -> Any:
        """Return the id of a parameter's node; None where there is none."""
        key = Key(db, rig, parameter)
        return self.node_id(*key) if key in self._parameters else None

    async def show(self, rig: Row, now_ns: int) -> None:
        """Write what the overview says of a rig's parameters; an unchanged value is not written again."""
        for row in rig["parameters"]:
            key = Key(rig["db"], rig["rig"], row["parameter"])
            if key not in self._parameters:
                await self._make(key, row)
            await self._write(key, row, now_ns)

    async def _make(self, key: Key, row: Row) -> None:
        parent = await self.rig(key.db, key.rig)
        node = await self._variable(parent, key, key.parameter, ua.VariantType.Double)
        await node.delete_reference(ua.ObjectIds.BaseDataVariableType, ua.ObjectIds.HasTypeDefinition)
        await node.add_reference(ua.ObjectIds.AnalogUnitType, ua.ObjectIds.HasTypeDefinition)
        unit = "" if row["unit"] in {None, "1"} else row["unit"]
        information = ua.EUInformation(NamespaceUri=NAMESPACE, UnitId=-1, DisplayName=ua.LocalizedText(unit))
        await node.add_property(self.node_id(*key, "EngineeringUnits"), "0:EngineeringUnits", information)
        for name in (*FIGURES.values(), *TEXTS.values()):
            kind = ua.VariantType.String if name in TEXTS.values() else ua.VariantType.Double
            await self._variable(node, (*key, name), name, kind)
        self._parameters.add(key)

    async def _variable(self, parent: Any, place: Iterable[str], name: str, kind: Any) -> Any:
        empty = ua.Variant(None, ua.VariantType.Null)
        data_type = ua.NodeId(kind.value)
        return await parent.add_variable(
            self.node_id(*place), f"{self.index}:{name}", empty, datatype=data_type
        )

    async def _write(self, key: Key, row: Row, now_ns: int) -> None:
        found = quality_of(row, now_ns)
        await self._put(self.node_id(*key), found.value, ua.VariantType.Double, found.t_ns, found.code)
        code = own_code(row, now_ns)
        for column, name in FIGURES.items():
            await self._put(self.node_id(*key, name), row[column], ua.VariantType.Double, row["t_ns"], code)
        for column, name in TEXTS.items():
            await self._put(
                self.node_id(*key, name), row[column] or "", ua.VariantType.String, row["t_ns"], "Good"
            )

    async def _put(self, node_id: Any, value: Any, kind: Any, t_ns: int, code: str) -> None:
        said = (value, t_ns, code)
        if self._written.get(node_id) == said:
            return
        self._written[node_id] = said
        variant = ua.Variant(None, ua.VariantType.Null) if value is None else ua.Variant(value, kind)
        status = ua.StatusCode(getattr(ua.StatusCodes, code))
        await self.server.write_attribute_value(
            node_id, ua.DataValue(variant, status, SourceTimestamp=instant(t_ns))
        )


def instant(t_ns: int) -> datetime:
    """Return integer nanoseconds as the time that OPC UA carries (to the microsecond here)."""
    return datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).replace(
        microsecond=t_ns % 1_000_000_000 // 1000
    )
