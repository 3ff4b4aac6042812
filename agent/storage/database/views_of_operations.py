# ruff: noqa: S608 - these statements are put together from this package's own texts only
"""The view that version 7 made anew: what to do about an alarm, how large it is, and where its rig stands."""

from agent.storage.database.views import covered, time_text


def _noted(column: str) -> str:
    return (
        f"(SELECT x.{column} FROM annotations x WHERE x.alarm_id = a.seq "
        f"ORDER BY x.seq DESC LIMIT 1) AS {column}"
    )


def _placed(column: str) -> str:
    return f"(SELECT p.{column} FROM sites p WHERE p.run_id = a.run_id) AS {column}"


OPERATIONS: tuple[str, ...] = (
    "CREATE INDEX annotations_by_alarm ON annotations (alarm_id)",
    "DROP VIEW v_alarms",
    f"""CREATE VIEW v_alarms AS SELECT a.seq AS id, g.name AS rig, a.run_id AS run_id, a.kind AS kind,
 a.parameter AS parameter, a.priority AS priority, a.state AS state, {time_text("a.raised_ns")} AS raised_at,
 {time_text("a.cleared_ns")} AS cleared_at, {time_text("a.acked_ns")} AS acked_at, a.acked_by AS acked_by,
 {time_text("a.shelved_until_ns")} AS shelved_until, a.delta AS delta, a.sd AS sd,
 a.limit_value AS limit_value,
 a.probability AS probability, a.message AS message, {_noted("advice")}, {_noted("percent")},
 {_placed("site")}, {_placed("labels")}
 FROM alarms a JOIN runs r ON r.seq = a.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE NOT {covered("a.run_id", "a.raised_ns")}""",
)
"""Came with version 7. labels is a JSON object."""
