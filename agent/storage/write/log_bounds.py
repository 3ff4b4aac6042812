# ruff: noqa: S608 - statements are put together from this module's own names; values are always bound
"""How many rows of what happened are kept: the newest of each table, counted, as a count needs no clock."""

import sqlite3

KEPT = 100_000
"""Events, alarms, verdicts, forecasts, trends, lost records: some 20 to 50 MB each: years of a quiet rig."""

_OLD = "seq <= (SELECT seq FROM {table} ORDER BY seq DESC LIMIT 1 OFFSET ?)"
_OVER = {"events": "", "hypotheses": "", "forecasts": "", "trends": "", "conditions": "", "notifications": "",
         "alarms": " AND cleared_ns IS NOT NULL",
         "event_records": " AND state IN ('purged', 'failed')"}  # fmt: skip
"""What of a table may go: an alarm that stands and a record whose file is there stay, however old."""


def surplus(connection: sqlite3.Connection, kept: int = KEPT) -> dict[str, list[int]]:
    """Return the numbers of what `purge_logs` would delete, by the topic of consumers that it is of."""
    events, alarms = (_OLD.format(table=table) + _OVER[table] for table in ("events", "alarms"))
    queries = {
        "events": f"SELECT seq FROM events WHERE {events}",
        "alarms": f"SELECT seq FROM alarm_events WHERE alarm_id IN (SELECT seq FROM alarms WHERE {alarms})",
    }
    return {topic: [seq for (seq,) in connection.execute(query, (kept,))] for topic, query in queries.items()}


def purge_logs(connection: sqlite3.Connection, kept: int = KEPT) -> None:
    """Delete the oldest rows of what happened beyond a number; inside a transaction."""
    for table, over in _OVER.items():
        condition = _OLD.format(table=table) + over
        if table == "alarms":
            for part in ("alarm_events", "shelves", "annotations"):
                query = f"DELETE FROM {part} WHERE alarm_id IN (SELECT seq FROM alarms WHERE {condition})"
                connection.execute(query, (kept,))
        connection.execute(f"DELETE FROM {table} WHERE {condition}", (kept,))
