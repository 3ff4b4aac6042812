# ruff: noqa: S608 - these statements are put together from this package's own texts only
"""The views of version 5: runs whose wall clock was stepped are one run, the newest row was stored last.

Such a run has a row in `runs` for each setting of its clock; `clocks` says which run they belong to.
"""

from agent.storage.database.views import (
    ESTIMATE_JOINS,
    NEWEST_OF_RUN,
    SD_REPEAT,
    TIER_SHOWN,
    covered,
    estimate_columns,
    time_text,
)

_RUN = "coalesce(c.part_of, r.seq)"
_PARTS = "CROSS JOIN runs r ON r.rig_id = g.seq LEFT JOIN clocks c ON c.run_id = r.seq"
_COLUMNS = estimate_columns(_RUN)

_WINDOWS = f"""SELECT {_COLUMNS}, f.chosen AS chosen
 FROM rigs g {_PARTS} CROSS JOIN hops h ON h.run_id = r.seq {ESTIMATE_JOINS}
 WHERE {TIER_SHOWN} AND NOT {covered("h.run_id", "h.t_ns")}"""

_ESTIMATES = f"""SELECT {_COLUMNS}
 FROM rigs g {_PARTS} CROSS JOIN hops h ON h.run_id = r.seq {ESTIMATE_JOINS}
 WHERE {TIER_SHOWN} AND f.chosen = 1 AND NOT {covered("h.run_id", "h.t_ns")}"""


def _newest_hop(kind: str, order: str) -> str:
    """Return SQL for the newest hop of a parameter over the runs of a rig that are, or are not, live."""
    return f"""SELECT * FROM (SELECT k.seq AS hop, k.t_ns AS t_ns, x.seq AS run
   FROM runs x CROSS JOIN hops k ON k.seq = ({NEWEST_OF_RUN}) WHERE x.rig_id = q.rig_id
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

_LATEST = f"""SELECT {_COLUMNS}
 FROM ({_LATEST_HOPS}) n CROSS JOIN hops h ON h.seq = n.hop CROSS JOIN runs r ON r.seq = h.run_id
 LEFT JOIN clocks c ON c.run_id = r.seq CROSS JOIN rigs g ON g.seq = r.rig_id
 {ESTIMATE_JOINS} WHERE s.parameter = n.parameter AND f.chosen = 1"""

_TIERS = f"""SELECT g.name AS rig, {_RUN} AS run_id, {time_text("h.t_ns")} AS time, h.t_ns AS t_ns,
 s.parameter AS parameter, s.unit AS unit, h.span AS span_s, p.n AS n, p.n_valid AS n_valid, e.value AS value,
 e.sd AS sd, p.low AS low, p.high AS high, w.status AS worst_status, w.reason AS worst_reason
 FROM rigs g {_PARTS} CROSS JOIN hops h ON h.run_id = r.seq AND h.span > 0
 {ESTIMATE_JOINS} CROSS JOIN spreads p ON p.seq = e.seq CROSS JOIN verdicts w ON w.seq = p.worst_id
 WHERE NOT {covered("h.run_id", "h.t_ns")}"""

_RUNS = f"""SELECT r.seq AS run_id, g.name AS rig, r.kind AS kind, {time_text("r.started_ns")} AS started_at,
 r.code_version AS code_version, r.config_sha256 AS config_sha256, r.baseline_id AS baseline_id,
 r.boot_id AS boot_id FROM runs r JOIN rigs g ON g.seq = r.rig_id
 WHERE NOT EXISTS (SELECT 1 FROM clocks c WHERE c.run_id = r.seq AND c.part_of <> r.seq)"""

_VIEWS = {
    "v_estimates": _ESTIMATES, "v_estimates_windows": _WINDOWS, "v_latest": _LATEST, "v_tiers": _TIERS,
    "v_runs": _RUNS,
}  # fmt: skip
STEPS: tuple[str, ...] = tuple(
    statement
    for view, text in _VIEWS.items()
    for statement in (f"DROP VIEW {view}", f"CREATE VIEW {view} AS {text}")
)

_VERDICTS = f"""SELECT g.name AS rig, coalesce(c.part_of, y.run_id) AS run_id, y.t_ns AS t_ns,
 {time_text("y.t_ns")} AS time, y.hypothesis AS hypothesis, y.size AS size, y.sd AS sd, y.unit AS unit,
 y.probability AS probability FROM hypotheses y JOIN runs r ON r.seq = y.run_id
 JOIN rigs g ON g.seq = r.rig_id
 LEFT JOIN clocks c ON c.run_id = y.run_id WHERE NOT {covered("y.run_id", "y.t_ns")}"""


def _with_repeat(text: str) -> str:
    """Return a view's text with sd_repeat behind its columns."""
    return text.replace("s.method AS method", f"s.method AS method, {SD_REPEAT}").replace(
        "w.reason AS worst_reason", f"w.reason AS worst_reason, {SD_REPEAT}"
    )


_REPEATED = {view: _with_repeat(text) for view, text in _VIEWS.items() if view != "v_runs"}
REPEAT_AND_VERDICTS: tuple[str, ...] = (
    *(s for view, text in _REPEATED.items() for s in (f"DROP VIEW {view}", f"CREATE VIEW {view} AS {text}")),
    f"CREATE VIEW v_verdicts AS {_VERDICTS}",
)
"""Came with version 6: sd_repeat, and what is believed of the constants of a rig."""
