# ruff: noqa: S608 - these statements are put together from this module's own texts only
"""The views that outsiders query; their columns are promised, the tables behind them are not.

Every view shows, for each instant, the newest run of a rig that covers it: a replay of a week replaces what
was shown of that week. Aggregates show only where the finer rows are gone, so no period is shown twice.

What a view says belongs to the version that brought it: a text is not changed, a later version makes the view
anew.
"""


def time_text(column: str) -> str:
    """Return SQL for integer nanoseconds as ISO 8601 UTC with nine decimals; times before 1970 as well."""
    fraction = f"(({column} % 1000000000 + 1000000000) % 1000000000)"
    seconds = f"({column} - {fraction}) / 1000000000"
    return (
        f"CASE WHEN {column} IS NOT NULL THEN "
        f"strftime('%Y-%m-%dT%H:%M:%S', {seconds}, 'unixepoch') || printf('.%09dZ', {fraction}) END"
    )


def covered(run: str, t_ns: str) -> str:
    """Return SQL that holds when a newer run of the rig covers that instant."""
    return (
        f"EXISTS (SELECT 1 FROM overlaps o WHERE o.run_id = {run} AND {t_ns} BETWEEN o.from_ns AND o.to_ns)"
    )


# estimates.repeat: sd_repeat in ten-thousandths of sd, NULL where they are the same
SD_REPEAT = "coalesce(e.sd * e.repeat * 1e-4, e.sd) AS sd_repeat"


def estimate_columns(run: str) -> str:
    """Return SQL for the columns of `v_estimates`; run: SQL for the number of the run."""
    return f"""g.name AS rig, {run} AS run_id, {time_text("h.t_ns")} AS time, h.t_ns AS t_ns,
 s.parameter AS parameter, s.unit AS unit, e.value AS value, e.value - s.reference AS delta,
 s.reference AS reference, s.baseline_id AS baseline_id, e.sd AS sd,
 coalesce(e.lower, e.value - f.t95 * e.sd) AS lower, coalesce(e.upper, e.value + f.t95 * e.sd) AS upper,
 v.status AS status, v.reason AS reason, e.held AS held, e.held_age_s AS held_age_s, f.window_s AS window_s,
 f.n_used AS n_used, f.n_missing AS n_missing, h.span AS span_s, s.method AS method"""


_ESTIMATE_COLUMNS = estimate_columns("r.seq")

# CROSS JOIN keeps SQLite to this order: rig, run, time, rows, names. Left to itself it may begin with the
# names.
ESTIMATE_JOINS = """CROSS JOIN estimates e ON e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023
 CROSS JOIN series s ON s.seq = e.series_id
 CROSS JOIN fits f ON f.seq = e.fit_id
 CROSS JOIN verdicts v ON v.seq = e.verdict_id"""

TIER_SHOWN = """h.span IN (0, 60, 3600) AND (h.span = 0 OR (h.span = 60 AND h.t_ns < r.full_from_ns)
 OR (h.span = 3600 AND h.t_ns < r.minute_from_ns))"""

_WINDOWS = f"""SELECT {_ESTIMATE_COLUMNS}, f.chosen AS chosen
 FROM rigs g CROSS JOIN runs r ON r.rig_id = g.seq CROSS JOIN hops h ON h.run_id = r.seq {ESTIMATE_JOINS}
 WHERE {TIER_SHOWN} AND NOT {covered("h.run_id", "h.t_ns")}"""

_ESTIMATES = f"""SELECT {_ESTIMATE_COLUMNS}
 FROM rigs g CROSS JOIN runs r ON r.rig_id = g.seq CROSS JOIN hops h ON h.run_id = r.seq {ESTIMATE_JOINS}
 WHERE {TIER_SHOWN} AND f.chosen = 1 AND NOT {covered("h.run_id", "h.t_ns")}"""

# The run whose last row is the newest is never covered by a newer one at that row, so this needs no look at
# overlaps.
NEWEST_OF_RUN = """SELECT m.seq FROM hops m WHERE m.run_id = x.seq AND m.span = 0
   AND EXISTS (SELECT 1 FROM estimates c CROSS JOIN series y ON y.seq = c.series_id
     CROSS JOIN fits d ON d.seq = c.fit_id
     WHERE c.seq BETWEEN m.seq * 1024 AND m.seq * 1024 + 1023 AND y.parameter = q.parameter AND d.chosen = 1)
   ORDER BY m.t_ns DESC, m.seq DESC LIMIT 1"""

_LATEST_HOPS = f"""SELECT q.rig_id AS rig_id, q.parameter AS parameter,
 (SELECT k.seq FROM runs x CROSS JOIN hops k ON k.seq = ({NEWEST_OF_RUN})
   WHERE x.rig_id = q.rig_id
   AND EXISTS (SELECT 1 FROM series z WHERE z.run_id = x.seq AND z.parameter = q.parameter)
   ORDER BY k.t_ns DESC, x.seq DESC LIMIT 1) AS hop
 FROM (SELECT DISTINCT r.rig_id AS rig_id, s.parameter AS parameter
 FROM series s JOIN runs r ON r.seq = s.run_id) q"""

_LATEST = f"""SELECT {_ESTIMATE_COLUMNS}
 FROM ({_LATEST_HOPS}) n CROSS JOIN hops h ON h.seq = n.hop CROSS JOIN runs r ON r.seq = h.run_id
 CROSS JOIN rigs g ON g.seq = r.rig_id
 {ESTIMATE_JOINS} WHERE s.parameter = n.parameter AND f.chosen = 1"""

_TIERS = f"""SELECT g.name AS rig, r.seq AS run_id, {time_text("h.t_ns")} AS time, h.t_ns AS t_ns,
 s.parameter AS parameter, s.unit AS unit, h.span AS span_s, p.n AS n, p.n_valid AS n_valid, e.value AS value,
 e.sd AS sd, p.low AS low, p.high AS high, w.status AS worst_status, w.reason AS worst_reason
 FROM rigs g CROSS JOIN runs r ON r.rig_id = g.seq CROSS JOIN hops h ON h.run_id = r.seq AND h.span > 0
 {ESTIMATE_JOINS} CROSS JOIN spreads p ON p.seq = e.seq CROSS JOIN verdicts w ON w.seq = p.worst_id
 WHERE NOT {covered("h.run_id", "h.t_ns")}"""

_ALARMS = f"""SELECT a.seq AS id, g.name AS rig, a.run_id AS run_id, a.kind AS kind, a.parameter AS parameter,
 a.priority AS priority, a.state AS state, {time_text("a.raised_ns")} AS raised_at,
 {time_text("a.cleared_ns")} AS cleared_at, {time_text("a.acked_ns")} AS acked_at, a.acked_by AS acked_by,
 {time_text("a.shelved_until_ns")} AS shelved_until, a.delta AS delta, a.sd AS sd,
 a.limit_value AS limit_value, a.probability AS probability, a.message AS message
 FROM alarms a JOIN runs r ON r.seq = a.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE NOT {covered("a.run_id", "a.raised_ns")}"""

_ALARM_EVENTS = f"""SELECT n.seq AS id, n.alarm_id AS alarm_id, n.t_ns AS t_ns, {time_text("n.t_ns")} AS time,
 n.from_state AS from_state, n.to_state AS to_state, n.cause AS cause, n.by_whom AS "by", n.comment AS comment
 FROM alarm_events n JOIN alarms a ON a.seq = n.alarm_id WHERE NOT {covered("a.run_id", "a.raised_ns")}"""

_HEALTH = f"""SELECT g.name AS rig, x.source AS source, x.t_ns AS t_ns, {time_text("x.t_ns")} AS time,
 x.received AS received, x.used AS used, x.rejected AS rejected, x.dropped AS dropped, x.gaps AS gaps,
 x.lag_s AS lag_s
 FROM health x JOIN runs r ON r.seq = x.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE NOT {covered("x.run_id", "x.t_ns")}"""

_HEALTH_REASONS = f"""SELECT g.name AS rig, x.source AS source, x.t_ns AS t_ns, k.key AS kind,
 j.key AS reason, j.value AS count
 FROM health x JOIN runs r ON r.seq = x.run_id JOIN rigs g ON g.seq = r.rig_id, json_each(x.reasons) k,
 json_each(k.value) j WHERE x.reasons IS NOT NULL AND NOT {covered("x.run_id", "x.t_ns")}"""

_EVENTS = f"""SELECT n.seq AS id, g.name AS rig, n.source AS source, n.t_ns AS t_ns,
 {time_text("n.t_ns")} AS time, n.cause AS cause, n.message AS message
 FROM events n JOIN runs r ON r.seq = n.run_id JOIN rigs g ON g.seq = r.rig_id"""

_RUNS = f"""SELECT r.seq AS run_id, g.name AS rig, r.kind AS kind, {time_text("r.started_ns")} AS started_at,
 r.code_version AS code_version, r.config_sha256 AS config_sha256, r.baseline_id AS baseline_id,
 r.boot_id AS boot_id FROM runs r JOIN rigs g ON g.seq = r.rig_id"""

VIEWS: tuple[str, ...] = (
    f"CREATE VIEW v_estimates AS {_ESTIMATES}",
    f"CREATE VIEW v_estimates_windows AS {_WINDOWS}",
    f"CREATE VIEW v_latest AS {_LATEST}",
    f"CREATE VIEW v_tiers AS {_TIERS}",
    f"CREATE VIEW v_alarms AS {_ALARMS}",
    f"CREATE VIEW v_alarm_events AS {_ALARM_EVENTS}",
    f"CREATE VIEW v_health AS {_HEALTH}",
    f"CREATE VIEW v_health_reasons AS {_HEALTH_REASONS}",
    f"CREATE VIEW v_events AS {_EVENTS}",
    f"CREATE VIEW v_runs AS {_RUNS}",
    "CREATE VIEW v_meta AS SELECT key, value FROM meta",
)

EVENT_RECORDS = f"""CREATE VIEW v_event_records AS
 SELECT e.seq AS id, g.name AS rig, e.run_id AS run_id, e.t_ns AS t_ns, {time_text("e.t_ns")} AS time,
 e.kind AS kind,
 e.parameter AS parameter, (SELECT a.seq FROM alarms a WHERE a.run_id = e.run_id AND a.kind = e.kind
 AND a.parameter = e.parameter AND a.raised_ns = e.t_ns) AS alarm_id, e.alarms AS alarms,
 e.from_ns AS from_ns, e.to_ns AS to_ns, e.samples AS samples, e.bytes AS bytes,
 e.state AS state, e.file AS file, r.config_sha256 AS config_sha256, r.code_version AS code_version,
 e.baseline_id AS baseline_id, e.message AS message
 FROM event_records e JOIN runs r ON r.seq = e.run_id JOIN rigs g ON g.seq = r.rig_id"""
"""Came with version 2."""

CLOCKS: tuple[str, ...] = (
    "DROP VIEW v_health",
    f"""CREATE VIEW v_health AS SELECT g.name AS rig, x.source AS source, x.t_ns AS t_ns,
 {time_text("x.t_ns")} AS time,
 x.received AS received, x.used AS used, x.rejected AS rejected, x.dropped AS dropped, x.gaps AS gaps,
 x.lag_s AS lag_s, json_extract(x.reasons, '$.clock.drift_ppm') AS drift_ppm,
 json_extract(x.reasons, '$.clock.drift_sd_ppm') AS drift_sd_ppm,
 json_extract(x.reasons, '$.clock.skew_s') AS skew_s,
 json_extract(x.reasons, '$.clock.skew_sd_s') AS skew_sd_s
 FROM health x JOIN runs r ON r.seq = x.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE NOT {covered("x.run_id", "x.t_ns")}""",
    "DROP VIEW v_health_reasons",
    f"CREATE VIEW v_health_reasons AS {_HEALTH_REASONS} AND k.key <> 'clock'",
)
"""Came with version 3: what is known of the sources' clocks, in v_health."""
