"""A step of an alarm as sent: a document, a subject and a text, and the key by which a repeat is known."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from agent.text import iso_time, local_time, printable


@dataclass(frozen=True, slots=True)
class Message:
    """What a target gets.

    Attributes:
        key: the same for every attempt, and of no other message: rig, number and time of the step.
        document: the step and its alarm, as JSON carries them.
    """

    key: str
    document: Mapping[str, Any]

    @property
    def subject(self) -> str:
        """The step in one line."""
        said = self.document
        where = f"{said['rig']} at {said['site']}" if said.get("site") else str(said["rig"])
        states = f"{said['from_state']} -> {said['to_state']}"
        return _one_line(f"[{said['priority']}] {where}: {said['message']} ({states})")

    @property
    def text(self) -> str:
        """The step for people, a line a fact."""
        said = self.document
        share = "" if said.get("percent") is None else f" ({said['percent']:+.3g} %)"
        lines = [
            f"{said['message']}{share}",
            f"alarm {said['alarm_id']}: {said['kind']} {said['parameter']}, priority {said['priority']}",
            f"{said['from_state']} -> {said['to_state']}: {said['cause']}{_by(said)}",
            f"at {local_time(said['t_ns'])}",
            f"rig {said['rig']}" + (f", {said['site']}" if said.get("site") else "") + _labels(said),
        ]
        lines += [f"what to do: {said['advice']}"] if said.get("advice") else []
        return printable("\n".join(_one_line(line) for line in lines)) + "\n"


def message_of(facts: Mapping[str, Any]) -> Message:
    """Return the message of a step, given what the database says of it."""
    labels = json.loads(facts["labels"]) if facts.get("labels") else {}
    document = {**facts, "labels": labels, "time": iso_time(facts["t_ns"])}
    key = f"{facts['rig']}-{facts['event_id']}-{facts['t_ns']}"
    return Message(re.sub(r"[^A-Za-z0-9_.-]", "_", key), {"key": key, **document})


def _by(said: Mapping[str, Any]) -> str:
    who = f" by {said['by']}" if said.get("by") else ""
    return who + (f" ({said['comment']})" if said.get("comment") else "")


def _labels(said: Mapping[str, Any]) -> str:
    return "".join(f", {name} {value}" for name, value in said.get("labels", {}).items())


def _one_line(text: str) -> str:
    return printable(" ".join(text.split()))
