"""Methods of conditions: each is one line to the agent's socket, answered once it is committed."""

import asyncio
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from asyncua import ua

from agent.cli.opcua.access import caller
from agent.cli.opcua.conditions import Condition, Conditions, Method
from agent.errors import AgentError
from agent.storage.maintenance import is_commanded
from agent.storage.tuning import COMMENT_LETTERS, LONGEST_SHELF_NS
from agent.storage.write.command_socket import ask

_REFUSED: Final[Mapping[tuple[str, str], str]] = {
    ("Acknowledge", "NORM"): "BadConditionBranchAlreadyAcked",
    ("Acknowledge", "ACKED"): "BadConditionBranchAlreadyAcked",
    ("Confirm", "NORM"): "BadConditionBranchAlreadyConfirmed",
    ("Confirm", "ACKED"): "BadConditionBranchAlreadyConfirmed",
    ("TimedShelve", "SHLVD"): "BadConditionAlreadyShelved",
}
"""What a method answers in a state, where Part 9 has a word of its own for it."""
_TYPES: Final[Mapping[str, tuple[str, ...]]] = {
    "Acknowledge": ("AcknowledgeableConditionType_Acknowledge",),
    "Confirm": ("AcknowledgeableConditionType_Confirm",),
    "AddComment": ("ConditionType_AddComment",),
    "RemoveFromService": ("AlarmConditionType_RemoveFromService",),
    "PlaceInService": ("AlarmConditionType_PlaceInService",),
    **{
        f"ShelvingState.{name}": (
            f"ShelvedStateMachineType_{name}",
            f"AlarmConditionType_ShelvingState_{name}",
        )
        for name in ("TimedShelve", "Unshelve", "OneShotShelve")
    },
}
"""The methods of the types, which clients may name instead of those of a condition."""


class Commands:
    """What operators do to alarms.

    Args:
        conditions: the alarms that there are.
        paths: of the databases, by name.
        done: called after each command that was carried out, so that its step is looked for at once.
    """

    def __init__(self, conditions: Conditions, paths: Mapping[str, Path], done: Callable[[], object]) -> None:
        self._conditions, self._paths, self._done = conditions, paths, done

    def methods(self) -> dict[str, Method]:
        """Return the methods by name, as `Conditions` has them on each condition."""
        return {
            "Acknowledge": self._acknowledge, "Confirm": self._confirm, "AddComment": _not_supported,
            "RemoveFromService": self._remove, "PlaceInService": self._place,
            "ShelvingState.TimedShelve": self._shelve, "ShelvingState.Unshelve": self._unshelve,
            "ShelvingState.OneShotShelve": _not_supported,
        }  # fmt: skip

    def link(self, server: Any) -> None:
        """Answer calls of the types' methods too: an object's id and the well-known id of a method."""
        for name, method in self.methods().items():
            for place in _TYPES[name]:
                node_id = ua.NodeId(getattr(ua.ObjectIds, place))
                if node_id in server.iserver.aspace:
                    server.link_method(server.get_node(node_id), method)

    async def _acknowledge(self, place: Any, *said: Any) -> Any:
        return await self._answered("Acknowledge", "acknowledge", place, said)

    async def _confirm(self, place: Any, *said: Any) -> Any:
        return await self._answered("Confirm", "acknowledge", place, said)

    async def _shelve(self, place: Any, *said: Any) -> Any:
        length_ms = said[0].Value if len(said) == 1 else None
        if not isinstance(length_ms, float | int) or not 0.0 < length_ms <= LONGEST_SHELF_NS / 1e6:
            return _status("BadShelvingTimeOutOfRange")
        return await self._do("TimedShelve", "shelve", place, length_ns=round(length_ms * 1e6))

    async def _unshelve(self, place: Any, *_said: Any) -> Any:
        return await self._do("Unshelve", "unshelve", place)

    async def _remove(self, place: Any, *_said: Any) -> Any:
        return await self._do("RemoveFromService", "out of service", place)

    async def _place(self, place: Any, *_said: Any) -> Any:
        return await self._do("PlaceInService", "return", place)

    async def _answered(self, method: str, cause: str, place: Any, said: tuple[Any, ...]) -> Any:
        """Carry out what names an event and brings a comment."""
        if len(said) != 2:
            return _status("BadArgumentsMissing" if len(said) < 2 else "BadTooManyArguments")
        event, comment = (argument.Value for argument in said)
        words = str(getattr(comment, "Text", None) or "")
        if len(words) > COMMENT_LETTERS:
            return _status("BadOutOfRange")
        found = self._conditions.find(place)
        if found is not None and not _is_of(event, found):
            return _status("BadEventIdUnknown")
        return await self._do(method, cause, place, comment=words or None)

    async def _do(
        self, method: str, cause: str, place: Any, *, comment: str | None = None, length_ns: int | None = None
    ) -> Any:
        by = caller.get()
        found = self._conditions.find(place)
        if by is None:
            return _status("BadUserAccessDenied")
        if found is None:
            return _status("BadNodeIdUnknown")
        refused = _refused(method, found.alarm["state"])
        if refused is not None:
            return _status(refused)
        path = self._paths[found.db]
        to_do = partial(ask, path, "alarm", cause=cause, ids=[found.alarm["id"]], brief=True)
        asked = partial(to_do, by=by, comment=comment, length_ns=length_ns)
        try:
            await asyncio.to_thread(asked)
        except AgentError:
            self._done()  # what is known here is perhaps not the newest
            return _status("BadInvalidState" if is_commanded(path) else "BadServerNotConnected")
        self._done()
        return _status("Good")


def _refused(method: str, state: str) -> str | None:
    """Return the status code of what a state does not allow by itself; the agent refuses the rest."""
    if method == "Unshelve" and state != "SHLVD":
        return "BadConditionNotShelved"
    return _REFUSED.get((method, state))


def _is_of(event: object, found: Condition) -> bool:
    """Tell whether an event's id is one of a condition's activation."""
    return isinstance(event, bytes) and event.rpartition(b"/")[0] == found.step.rpartition(b"/")[0]


async def _not_supported(_place: Any, *_said: Any) -> Any:
    return _status("BadNotSupported")


def _status(name: str) -> Any:
    return ua.StatusCode(getattr(ua.StatusCodes, name))
