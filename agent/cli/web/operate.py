"""What an operator does to an alarm from the page: a line to the agent's socket, answered once committed."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from agent.errors import UsageError
from agent.storage.read.times import age_ns
from agent.storage.tuning import COMMENT_LETTERS
from agent.storage.write.command_socket import ask

CAUSES: Final[Mapping[str, str]] = {"ack": "acknowledge", "shelve": "shelve", "unshelve": "unshelve"}
"""What is asked of the agent, by the name that it has in addresses."""


def operate(db: Path, action: str, alarm: int, by: str, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Have the agent acknowledge, shelve or unshelve an alarm; returns its answer.

    Args:
        db: the database that the agent owns.
        action: one of `CAUSES`.
        alarm: its id.
        by: who does it.
        asked: `comment`, and for shelve `for`, how long.

    Raises:
        UsageError: what was asked makes no sense; StoreError: no agent listens, or it refuses.
    """
    comment = asked.get("comment")
    if comment is not None and not (isinstance(comment, str) and len(comment) <= COMMENT_LETTERS):
        raise UsageError.at("comment", f"is no text of at most {COMMENT_LETTERS} characters", "shorten it")
    length = _length_ns(asked.get("for")) if action == "shelve" else None
    return ask(
        db, "alarm", cause=CAUSES[action], ids=[alarm], by=by, comment=comment, length_ns=length, brief=True
    )


def _length_ns(text: object) -> int:
    found = age_ns(text) if isinstance(text, str) and len(text) < 20 else None
    if not found:
        raise UsageError.at(
            "for", f"{str(text)[:50]!r} is no length of time", "give one such as 30m, 8h or 2d"
        )
    return found
