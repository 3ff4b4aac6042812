"""The view that came with version 10: what became of each notification."""

from agent.storage.database.views import time_text

NOTIFICATIONS: tuple[str, ...] = (
    "CREATE INDEX notifications_pending ON notifications (target) WHERE state = 'pending'",
    f"""CREATE VIEW v_notifications AS SELECT n.seq AS id, n.alarm_event_id AS alarm_event_id,
 n.target AS target,
 n.state AS state, n.attempts AS attempts, n.last_error AS last_error, {time_text("n.done_ns")} AS done_at
 FROM notifications n""",  # noqa: S608 - put together from this package's own texts only
)
"""Came with version 10."""
