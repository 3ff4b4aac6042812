# ruff: noqa: S608 - these statements are put together from this package's own texts only
"""The view of the paper's conditions by window, new in version 8; its text belongs to that version."""

from agent.storage.database.views import covered, time_text

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
