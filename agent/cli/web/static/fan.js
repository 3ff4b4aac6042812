// Forecasts on the chart: the fan of the newest, and faintly those of the past.
import { ask, query } from "./dom.js";

/** Return the fan {from: [t_ns, value], limit, times: P10, P50, P90 in s} of a row of v_forecast, or of now; or null. */
export async function fanOf(shown, row) {
  return row ? stored(row) : madeNow(shown);
}

/** Return the fan of a row of v_forecast; null where it has no band. */
function stored({ status, made_at_ns, level, limit_value, p10_ns, p50_ns, p90_ns }) {
  const times = [p10_ns, p50_ns, p90_ns].map((t) => (t === null ? NaN : t / 1e9));
  return status === "ok" && times.every(Number.isFinite) ? { from: [made_at_ns, level], limit: limit_value, times } : null;
}

/** Return the fan of a forecast that is made of the rows as they are; null where none can be. */
async function madeNow({ db, rig, parameter, reference, limit, delta, t_ns, value }) {
  if (!limit || reference === null || delta === null) return null;
  const crossed = reference + Math.sign(delta || 1) * limit;
  const { forecast } = await ask(`trend?${query({ db, rig, parameter, limit: crossed })}`);
  const times = ["p10_at", "p50_at", "p90_at"].map((key) => Date.parse((forecast?.[key] ?? "").slice(0, 23) + "Z") / 1e3);
  return forecast?.status === "ok" && times.every(Number.isFinite) ? { from: [t_ns, value], limit: crossed, times } : null;
}

/** Draw the forecasts of the past faintly, each from where it began to its median at the limit. */
export function drawPast({ ctx, bbox, valToPos }, past, colour) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.strokeStyle = `${colour}66`;
  ctx.lineWidth = devicePixelRatio;
  ctx.beginPath();
  for (const row of past) {
    ctx.moveTo(valToPos(row.made_at_ns / 1e9, "x", true), valToPos(row.level, "y", true));
    ctx.lineTo(valToPos(row.p50_ns / 1e9, "x", true), valToPos(row.limit_value, "y", true));
  }
  ctx.stroke();
  ctx.restore();
}
