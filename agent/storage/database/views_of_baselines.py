# ruff: noqa: S608 - these statements are put together from this package's own texts only
"""The view of baselines, which came with version 7."""

from agent.storage.database.views import time_text

_BASELINES = f"""SELECT b.seq AS baseline_id, g.name AS rig, b.parameter AS parameter, b.unit AS unit,
 b.reference AS reference, b.sd AS sd, b.spread_sd AS spread_sd, b.within_sd AS within_sd,
 b.days_sd AS days_sd,
 b.correlation_s AS correlation_s, b.n_effective AS n_effective, b.covariates AS covariates,
 {time_text("b.from_ns")} AS learnt_from, {time_text("b.until_ns")} AS learnt_until, b.n AS n,
 b.seq = (SELECT max(x.seq) FROM baselines x WHERE x.rig_id = b.rig_id AND x.parameter = b.parameter)
 AS newest, b.from_ns AS from_ns, b.until_ns AS until_ns, b.graph AS graph
 FROM baselines b JOIN rigs g ON g.seq = b.rig_id"""

BASELINES: tuple[str, ...] = (f"CREATE VIEW v_baselines AS {_BASELINES}",)
