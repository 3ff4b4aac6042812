# ruff: noqa: S608 - these statements are put together from this package's own texts only
"""The views that came with versions 7, 8 and 9; their texts belong to those versions."""

from agent.storage.database.views import covered, time_text

FORECASTS = f"""CREATE VIEW v_forecast AS SELECT g.name AS rig, coalesce(c.part_of, f.run_id) AS run_id,
 f.parameter AS parameter, f.limit_value AS limit_value, f.made_ns AS made_at_ns,
 {time_text("f.made_ns")} AS made_at,
 {time_text("f.p10_ns")} AS p10_at, {time_text("f.p50_ns")} AS p50_at, {time_text("f.p90_ns")} AS p90_at,
 f.chance AS chance, f.status AS status, f.family AS family, r.code_version AS code_version,
 {time_text("f.scored_ns")} AS scored_at, {time_text("f.crossed_ns")} AS crossed_at, f.crps AS crps,
 f.held AS held,
 f.seq AS id, f.level AS level, f.horizon_s AS horizon_s, f.draws AS draws, f.cause AS cause,
 f.p10_ns AS p10_ns, f.p50_ns AS p50_ns, f.p90_ns AS p90_ns, f.scored_ns AS scored_ns,
 f.crossed_ns AS crossed_ns
 FROM forecasts f JOIN runs r ON r.seq = f.run_id JOIN rigs g ON g.seq = r.rig_id
 LEFT JOIN clocks c ON c.run_id = f.run_id WHERE NOT {covered("f.run_id", "f.made_ns")}"""
"""Version 7."""


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
"""Version 7: what to do about an alarm, how large it is, where its rig stands; labels is a JSON object."""

_BASELINES = f"""SELECT b.seq AS baseline_id, g.name AS rig, b.parameter AS parameter, b.unit AS unit,
 b.reference AS reference, b.sd AS sd, b.spread_sd AS spread_sd, b.within_sd AS within_sd,
 b.days_sd AS days_sd,
 b.correlation_s AS correlation_s, b.n_effective AS n_effective, b.covariates AS covariates,
 {time_text("b.from_ns")} AS learnt_from, {time_text("b.until_ns")} AS learnt_until, b.n AS n,
 b.seq = (SELECT max(x.seq) FROM baselines x WHERE x.rig_id = b.rig_id AND x.parameter = b.parameter)
 AS newest, b.from_ns AS from_ns, b.until_ns AS until_ns, b.graph AS graph
 FROM baselines b JOIN rigs g ON g.seq = b.rig_id"""

BASELINES: tuple[str, ...] = (f"CREATE VIEW v_baselines AS {_BASELINES}",)
"""Version 7."""

NOTIFICATIONS: tuple[str, ...] = (
    "CREATE INDEX notifications_pending ON notifications (target) WHERE state = 'pending'",
    f"""CREATE VIEW v_notifications AS SELECT n.seq AS id, n.alarm_event_id AS alarm_event_id,
 n.target AS target,
 n.state AS state, n.attempts AS attempts, n.last_error AS last_error, {time_text("n.done_ns")} AS done_at
 FROM notifications n""",
)
"""Version 7: what became of each notification."""

_COVARIATES = f"""SELECT g.name AS rig, x.run_id AS run_id, x.name AS name, x.t_ns AS t_ns,
 {time_text("x.t_ns")} AS time, x.value AS value, x.unit AS unit, x.n AS n, x.span AS span_s
 FROM covariates x JOIN runs r ON r.seq = x.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE NOT {covered("x.run_id", "x.t_ns")}"""

COVARIATES: tuple[str, ...] = (
    "CREATE INDEX covariates_by_run ON covariates (run_id, span, t_ns)",
    f"CREATE VIEW v_covariates AS {_COVARIATES}",
)
"""Version 8: the index of their rows and the view, in the order in which they are made."""

CONDITIONS: tuple[str, ...] = (
    f"""CREATE VIEW v_conditions AS SELECT g.name AS rig, coalesce(c.part_of, o.run_id) AS run_id,
 o.t_ns AS t_ns,
 {time_text("o.t_ns")} AS time, o.window_s AS window_s, o.defect AS condition_11,
 o.defect_outputs AS condition_11_outputs, o.rank AS rank, o.rank_joined AS rank_joined,
 o.rank = o.rank_joined AS condition_12, o.defect_special AS condition_15, o.z_zero AS z_zero,
 o.iterations AS iterations, o.converged AS converged, o.cost AS cost, o.step AS step, o.passes AS passes,
 o.ratio AS ratio, o.trail AS trail, o.seq AS id FROM conditions o JOIN runs r ON r.seq = o.run_id
 JOIN rigs g ON g.seq = r.rig_id LEFT JOIN clocks c ON c.run_id = o.run_id
 WHERE NOT {covered("o.run_id", "o.t_ns")}""",
)
"""Version 8: the paper's conditions by window."""

TRENDS = f"""CREATE VIEW v_trend AS SELECT g.name AS rig, coalesce(c.part_of, o.run_id) AS run_id,
 o.parameter AS parameter, o.t_ns AS t_ns, {time_text("o.t_ns")} AS time, o.value AS value, o.sd AS sd,
 o.slope_per_day AS slope_per_day, o.slope_sd AS slope_sd, o.trend AS trend, r.code_version AS code_version,
 o.seq AS id FROM trends o JOIN runs r ON r.seq = o.run_id JOIN rigs g ON g.seq = r.rig_id
 LEFT JOIN clocks c ON c.run_id = o.run_id WHERE NOT {covered("o.run_id", "o.t_ns")}"""
"""Version 9."""
