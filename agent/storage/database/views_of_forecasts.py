# ruff: noqa: S608 - these statements are put together from this package's own texts only
"""The view of forecasts, which came with version 7; its text belongs to that version."""

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
