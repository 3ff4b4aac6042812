# ruff: noqa: S608 - these statements are put together from this package's own texts only
"""The view of covariates, which came with version 8."""

from agent.storage.database.views import covered, time_text

_COVARIATES = f"""SELECT g.name AS rig, x.run_id AS run_id, x.name AS name, x.t_ns AS t_ns,
 {time_text("x.t_ns")} AS time, x.value AS value, x.unit AS unit, x.n AS n, x.span AS span_s
 FROM covariates x JOIN runs r ON r.seq = x.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE NOT {covered("x.run_id", "x.t_ns")}"""

COVARIATES: tuple[str, ...] = (
    "CREATE INDEX covariates_by_run ON covariates (run_id, span, t_ns)",
    f"CREATE VIEW v_covariates AS {_COVARIATES}",
)
"""The index of their rows and the view, in the order in which they are made."""
