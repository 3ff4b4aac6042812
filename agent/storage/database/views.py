# ruff: noqa: S608 - these statements are put together from this module's own texts only
"""The views that outsiders query; their columns are promised, the tables behind them are not.

Every view shows, for each instant, the newest run of a rig that covers it: a replay of a week replaces what
was shown of that week. Aggregates show only where the finer rows are gone, so no period is shown twice. Runs
whose wall clock was stepped are one run, though such a run has a row in `runs` for each setting of its clock:
`clocks` says which run they belong to.

What a view says belongs to the version that made it so (`schema`): a text that changes is of a new version.
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


def _own(alias: str, names: str) -> str:
    """Return SQL for columns of a table that a view shows under their own names."""
    return ", ".join(f"{alias}.{name} AS {name}" for name in names.split())


def _run_of(alias: str) -> str:
    """Return SQL for the run that a row is of, joined by `_placed_in_parts`."""
    return f"coalesce(c.part_of, {alias}.run_id) AS run_id"


def _placed(alias: str) -> str:
    """Return SQL that joins the run and the rig of a table's rows."""
    return f"JOIN runs r ON r.seq = {alias}.run_id JOIN rigs g ON g.seq = r.rig_id"


def _placed_in_parts(alias: str) -> str:
    """Return SQL that joins the run, the rig and the clock setting of a table's rows."""
    return f"{_placed(alias)} LEFT JOIN clocks c ON c.run_id = {alias}.run_id"


_RUN = "coalesce(c.part_of, r.seq)"
_PARTS = "CROSS JOIN runs r ON r.rig_id = g.seq LEFT JOIN clocks c ON c.run_id = r.seq"

# estimates.repeat: sd_repeat in ten-thousandths of sd, NULL where they are the same
_SD_REPEAT = "coalesce(e.sd * e.repeat * 1e-4, e.sd) AS sd_repeat"

_COLUMNS = f"""g.name AS rig, {_RUN} AS run_id, {time_text("h.t_ns")} AS time, h.t_ns AS t_ns,
 {_own("s", "parameter unit")}, e.value AS value, e.value - s.reference AS delta,
 {_own("s", "reference baseline_id")}, e.sd AS sd,
 coalesce(e.lower, e.value - f.t95 * e.sd) AS lower, coalesce(e.upper, e.value + f.t95 * e.sd) AS upper,
 {_own("v", "status reason")}, {_own("e", "held held_age_s")}, {_own("f", "window_s n_used n_missing")},
 h.span AS span_s, s.method AS method, {_SD_REPEAT}"""

# CROSS JOIN keeps SQLite to this order: rig, run, time, rows, names. Left to itself it may begin with the
# names.
_JOINS = """CROSS JOIN estimates e ON e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023
 CROSS JOIN series s ON s.seq = e.series_id
 CROSS JOIN fits f ON f.seq = e.fit_id
 CROSS JOIN verdicts v ON v.seq = e.verdict_id"""

_TIER_SHOWN = """h.span IN (0, 60, 3600) AND (h.span = 0 OR (h.span = 60 AND h.t_ns < r.full_from_ns)
 OR (h.span = 3600 AND h.t_ns < r.minute_from_ns))"""

_NEWEST_OF_RUN = """SELECT m.seq FROM hops m WHERE m.run_id = x.seq AND m.span = 0
   AND EXISTS (SELECT 1 FROM estimates c CROSS JOIN series y ON y.seq = c.series_id
     CROSS JOIN fits d ON d.seq = c.fit_id
     WHERE c.seq BETWEEN m.seq * 1024 AND m.seq * 1024 + 1023 AND y.parameter = q.parameter AND d.chosen = 1)
   ORDER BY m.t_ns DESC, m.seq DESC LIMIT 1"""


def _newest_hop(kind: str, order: str) -> str:
    """Return SQL for the newest hop of a parameter over the runs of a rig that are, or are not, live."""
    return f"""SELECT * FROM (SELECT k.seq AS hop, k.t_ns AS t_ns, x.seq AS run
   FROM runs x CROSS JOIN hops k ON k.seq = ({_NEWEST_OF_RUN}) WHERE x.rig_id = q.rig_id
   AND x.kind {kind} 'live'
   AND EXISTS (SELECT 1 FROM series z WHERE z.run_id = x.seq AND z.parameter = q.parameter)
   ORDER BY {order} LIMIT 1)"""


# Live rows follow one another as they were stored, whatever the wall clock said; a replay is of the time of
# its stamps. The newest is never covered by a newer run, so this needs no look at overlaps.
_LATEST_HOPS = f"""SELECT q.rig_id AS rig_id, q.parameter AS parameter,
 (SELECT hop FROM ({_newest_hop("=", "k.seq DESC")} UNION ALL {_newest_hop("<>", "k.t_ns DESC, x.seq DESC")})
   ORDER BY t_ns DESC, run DESC LIMIT 1) AS hop
 FROM (SELECT DISTINCT r.rig_id AS rig_id, s.parameter AS parameter
 FROM series s JOIN runs r ON r.seq = s.run_id) q"""


def _of_alarm(column: str) -> str:
    """Return SQL for a column of the newest annotation of an alarm."""
    return (
        f"(SELECT x.{column} FROM annotations x WHERE x.alarm_id = a.seq "
        f"ORDER BY x.seq DESC LIMIT 1) AS {column}"
    )


def _of_site(column: str) -> str:
    return f"(SELECT p.{column} FROM sites p WHERE p.run_id = a.run_id) AS {column}"


ALARM_NOTES = ", ".join([*map(_of_alarm, ("advice", "percent")), *map(_of_site, ("site", "labels"))])
"""What to do about alarm `a`, how large it is, where its rig stands; labels is a JSON object."""

VIEWS = {
    "v_estimates": f"""SELECT {_COLUMNS}
 FROM rigs g {_PARTS} CROSS JOIN hops h ON h.run_id = r.seq {_JOINS}
 WHERE {_TIER_SHOWN} AND f.chosen = 1 AND NOT {covered("h.run_id", "h.t_ns")}""",
    "v_estimates_windows": f"""SELECT {_COLUMNS}, f.chosen AS chosen
 FROM rigs g {_PARTS} CROSS JOIN hops h ON h.run_id = r.seq {_JOINS}
 WHERE {_TIER_SHOWN} AND NOT {covered("h.run_id", "h.t_ns")}""",
    "v_latest": f"""SELECT {_COLUMNS}
 FROM ({_LATEST_HOPS}) n CROSS JOIN hops h ON h.seq = n.hop CROSS JOIN runs r ON r.seq = h.run_id
 LEFT JOIN clocks c ON c.run_id = r.seq CROSS JOIN rigs g ON g.seq = r.rig_id
 {_JOINS} WHERE s.parameter = n.parameter AND f.chosen = 1""",
    "v_tiers": f"""SELECT g.name AS rig, {_RUN} AS run_id, {time_text("h.t_ns")} AS time, h.t_ns AS t_ns,
 {_own("s", "parameter unit")}, h.span AS span_s, {_own("p", "n n_valid")}, {_own("e", "value sd")},
 {_own("p", "low high")}, w.status AS worst_status, w.reason AS worst_reason, {_SD_REPEAT}
 FROM rigs g {_PARTS} CROSS JOIN hops h ON h.run_id = r.seq AND h.span > 0
 {_JOINS} CROSS JOIN spreads p ON p.seq = e.seq CROSS JOIN verdicts w ON w.seq = p.worst_id
 WHERE NOT {covered("h.run_id", "h.t_ns")}""",
    "v_alarms": f"""SELECT a.seq AS id, g.name AS rig, {_own("a", "run_id kind parameter priority state")},
 {time_text("a.raised_ns")} AS raised_at, {time_text("a.cleared_ns")} AS cleared_at,
 {time_text("a.acked_ns")} AS acked_at, a.acked_by AS acked_by,
 {time_text("a.shelved_until_ns")} AS shelved_until, {_own("a", "delta sd limit_value probability message")},
 {ALARM_NOTES} FROM alarms a {_placed("a")} WHERE NOT {covered("a.run_id", "a.raised_ns")}""",
    "v_alarm_events": f"""SELECT n.seq AS id, n.alarm_id AS alarm_id, n.t_ns AS t_ns,
 {time_text("n.t_ns")} AS time, {_own("n", "from_state to_state cause")}, n.by_whom AS "by",
 n.comment AS comment
 FROM alarm_events n JOIN alarms a ON a.seq = n.alarm_id WHERE NOT {covered("a.run_id", "a.raised_ns")}""",
    "v_health": f"""SELECT g.name AS rig, x.source AS source, x.t_ns AS t_ns, {time_text("x.t_ns")} AS time,
 {_own("x", "received used rejected dropped gaps lag_s")},
 {
        ", ".join(
            f"json_extract(x.reasons, '$.clock.{name}') AS {name}"
            for name in ("drift_ppm", "drift_sd_ppm", "skew_s", "skew_sd_s")
        )
    }
 FROM health x {_placed("x")} WHERE NOT {covered("x.run_id", "x.t_ns")}""",
    "v_health_reasons": f"""SELECT g.name AS rig, x.source AS source, x.t_ns AS t_ns, k.key AS kind,
 j.key AS reason, j.value AS count FROM health x {_placed("x")}, json_each(x.reasons) k, json_each(k.value) j
 WHERE x.reasons IS NOT NULL AND NOT {covered("x.run_id", "x.t_ns")} AND k.key <> 'clock'""",
    "v_events": f"""SELECT n.seq AS id, g.name AS rig, n.source AS source, n.t_ns AS t_ns,
 {time_text("n.t_ns")} AS time, n.cause AS cause, n.message AS message FROM events n {_placed("n")}""",
    "v_runs": f"""SELECT r.seq AS run_id, g.name AS rig, r.kind AS kind,
 {time_text("r.started_ns")} AS started_at, {_own("r", "code_version config_sha256 baseline_id boot_id")}
 FROM runs r JOIN rigs g ON g.seq = r.rig_id
 WHERE NOT EXISTS (SELECT 1 FROM clocks c WHERE c.run_id = r.seq AND c.part_of <> r.seq)""",
    "v_meta": "SELECT key, value FROM meta",
    "v_event_records": f"""SELECT e.seq AS id, g.name AS rig, e.run_id AS run_id, e.t_ns AS t_ns,
 {time_text("e.t_ns")} AS time, e.kind AS kind, e.parameter AS parameter, (SELECT a.seq FROM alarms a
 WHERE a.run_id = e.run_id AND a.kind = e.kind AND a.parameter = e.parameter AND a.raised_ns = e.t_ns)
 AS alarm_id, {_own("e", "alarms from_ns to_ns samples bytes state file")},
 {_own("r", "config_sha256 code_version")}, {_own("e", "baseline_id message")}
 FROM event_records e {_placed("e")}""",
    "v_verdicts": f"""SELECT g.name AS rig, {_run_of("y")}, y.t_ns AS t_ns, {time_text("y.t_ns")} AS time,
 {_own("y", "hypothesis size sd unit probability")}
 FROM hypotheses y {_placed_in_parts("y")} WHERE NOT {covered("y.run_id", "y.t_ns")}""",
    "v_forecast": f"""SELECT g.name AS rig, {_run_of("f")}, {_own("f", "parameter limit_value")},
 f.made_ns AS made_at_ns, {time_text("f.made_ns")} AS made_at, {time_text("f.p10_ns")} AS p10_at,
 {time_text("f.p50_ns")} AS p50_at, {time_text("f.p90_ns")} AS p90_at, {_own("f", "chance status family")},
 r.code_version AS code_version, {time_text("f.scored_ns")} AS scored_at,
 {time_text("f.crossed_ns")} AS crossed_at, {_own("f", "crps held")}, f.seq AS id,
 {_own("f", "level horizon_s draws cause p10_ns p50_ns p90_ns scored_ns crossed_ns")}
 FROM forecasts f {_placed_in_parts("f")} WHERE NOT {covered("f.run_id", "f.made_ns")}""",
    "v_baselines": f"""SELECT b.seq AS baseline_id, g.name AS rig, {_own("b", "parameter unit reference sd")},
 {_own("b", "spread_sd within_sd days_sd correlation_s n_effective covariates")},
 {time_text("b.from_ns")} AS learnt_from, {time_text("b.until_ns")} AS learnt_until, b.n AS n,
 b.seq = (SELECT max(x.seq) FROM baselines x WHERE x.rig_id = b.rig_id AND x.parameter = b.parameter)
 AS newest, {_own("b", "from_ns until_ns graph")} FROM baselines b JOIN rigs g ON g.seq = b.rig_id""",
    "v_notifications": f"""SELECT n.seq AS id,
 {_own("n", "alarm_event_id target state attempts last_error")}, {time_text("n.done_ns")} AS done_at
 FROM notifications n""",
    "v_covariates": f"""SELECT g.name AS rig, x.run_id AS run_id, x.name AS name, x.t_ns AS t_ns,
 {time_text("x.t_ns")} AS time, {_own("x", "value unit n")}, x.span AS span_s
 FROM covariates x {_placed("x")} WHERE NOT {covered("x.run_id", "x.t_ns")}""",
    "v_conditions": f"""SELECT g.name AS rig, {_run_of("o")}, o.t_ns AS t_ns, {time_text("o.t_ns")} AS time,
 o.window_s AS window_s, o.defect AS condition_11, o.defect_outputs AS condition_11_outputs,
 {_own("o", "rank rank_joined")}, o.rank = o.rank_joined AS condition_12, o.defect_special AS condition_15,
 {_own("o", "z_zero iterations converged cost step passes ratio trail")}, o.seq AS id
 FROM conditions o {_placed_in_parts("o")} WHERE NOT {covered("o.run_id", "o.t_ns")}""",
    "v_trend": f"""SELECT g.name AS rig, {_run_of("o")}, o.parameter AS parameter, o.t_ns AS t_ns,
 {time_text("o.t_ns")} AS time, {_own("o", "value sd slope_per_day slope_sd trend")},
 r.code_version AS code_version, o.seq AS id
 FROM trends o {_placed_in_parts("o")} WHERE NOT {covered("o.run_id", "o.t_ns")}""",
}
"""The text of each view, as this version has it."""
