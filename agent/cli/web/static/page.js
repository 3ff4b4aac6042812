// The page: overview, the chosen rig, and what is committed as it comes.
import { Alarms } from "./alarms.js";
import { Chart } from "./chart.js";
import { age, ask, byId, instant, make, number, query, replaceItems, stateOf, withSd } from "./dom.js";
import { bar, drawing } from "./drawing.js";

const EVERY_MS = 10000;
const alarms = new Alarms();
const chart = new Chart();
const models = new Map();
let rigs = [];
let chosen = null; // "db/rig"
let parameter = null;
let pending = null;

const keyOf = (rig) => `${rig.db}/${rig.rig}`;
const lookOf = (rig) => (rig.alarms.some((a) => ["UNACK", "ACKED"].includes(a.state)) ? "bad" : rig.words === "normal" ? "good" : "doubt");

async function load() {
  try {
    const [overview] = await Promise.all([ask("overview"), alarms.load()]);
    rigs = overview.rigs;
    if (!rigs.some((rig) => keyOf(rig) === chosen)) chosen = rigs.length ? keyOf(rigs[0]) : null;
    showRigs();
    await showRig();
    const unread = [...overview.errors, ...(overview.refused ? [`${overview.refused} rows are not shown, their checksums are wrong`] : [])];
    if (unread.length || byId("notice").dataset.failed) say(unread.join("\n"));
  } catch (error) {
    if (error.status === 401) alarms.openDialog();
    else say(error.message);
  }
}

function say(words) {
  byId("notice").textContent = words;
  byId("notice").dataset.failed = words ? "1" : "";
}

function showRigs() {
  replaceItems(byId("rig-list"), rigs.map((rig) => make(
    "li", { class: lookOf(rig), "data-key": keyOf(rig) },
    make("button", {
      type: "button", "data-part": "rig", "aria-current": String(keyOf(rig) === chosen),
      on: { click: () => { chosen = keyOf(rig); parameter = null; showRigs(); showRig(); } },
    }, rig.rig),
    " ", make("span", { class: "word" }, rig.words),
    make("span", { class: "quiet" }, rig.lag_s === null ? " no rows yet" : ` newest row ${age(rig.lag_s)} ago`),
  )));
}

async function showRig() {
  const rig = rigs.find((one) => keyOf(one) === chosen);
  if (!rig) return;
  byId("rig-title").textContent = `Rig ${rig.rig}`;
  showParameters(rig);
  showCovariates(rig);
  showSources(rig);
  const states = Object.fromEntries(rig.parameters.map((p) => [p.parameter, p]));
  const model = await modelOf(rig);
  byId("model").replaceChildren(...(model?.masses.length ? [drawing(model, states)] : []));
  byId("known").textContent = rig.known;
  chart.forecast();
  await showForecasts(rig);
  const { verdicts } = await ask(`verdicts?${query({ db: rig.db, rig: rig.rig })}`);
  const items = verdicts.slice(-5).reverse().map((v) => make(
    "li", {}, `${v.hypothesis} is off by ${withSd(v.size, v.sd)} ${v.unit}, probability ${number(v.probability, 3)}, `, instant(v.time),
  ));
  replaceItems(byId("verdict-list"), items.length ? items : [make("li", {}, "nothing but what is configured")]);
}

/** Show what was forecast of each parameter, and how good the forecasts that are scored were. */
async function showForecasts(rig) {
  const { records } = await ask(`forecasts?${query({ db: rig.db, rig: rig.rig })}`);
  const items = records.map((r) => make(
    "li", { "data-key": r.parameter },
    make("p", {}, make("span", { class: "word" }, r.parameter), `: ${r.words}, limit ${number(r.limit_value)}; made `, instant(r.made_at)),
    ...r.record_words.map((words) => make("p", { class: "quiet" }, words)),
  ));
  replaceItems(byId("forecast-list"), items.length ? items : [make("li", {}, "none is made yet")]);
}

async function modelOf(rig) {
  const key = keyOf(rig);
  if (!models.has(key)) {
    const known = (await ask("rigs")).rigs.find((one) => keyOf(one) === key);
    models.set(key, known?.model ? await ask(`model?${query({ db: rig.db, rig: rig.rig })}`) : null);
  }
  return models.get(key);
}

function showParameters(rig) {
  if (!rig.parameters.some((p) => p.parameter === parameter)) {
    parameter = [...rig.parameters].sort((a, b) => (b.alarm ? 1 : 0) - (a.alarm ? 1 : 0) || (b.used ?? 0) - (a.used ?? 0))[0]?.parameter ?? null;
  }
  replaceItems(byId("parameter-list"), rig.parameters.map((p) => item(rig, p)));
  const shown = rig.parameters.find((p) => p.parameter === parameter);
  if (shown) chart.select({ db: rig.db, rig: rig.rig, ...shown });
}

function item(rig, p) {
  const pick = () => { parameter = p.parameter; showParameters(rig); };
  const words = [p.status, p.reason].filter(Boolean).join(": ") + (p.alarm ? `, alarm ${p.alarm}` : "");
  const value = make("data", { value: p.value ?? "", "data-sd": p.sd ?? "" }, withSd(p.value, p.sd));
  const held = p.status !== "valid" && p.held !== null ? ` (last valid ${number(p.held, 4)}, ${age(p.held_age_s ?? 0)} ago)` : "";
  const limit = p.limit ? `limit ±${number(p.limit, 4)}${p.used === null ? "" : `, ${Math.round(100 * p.used)} % used`}` : "no limit";
  return make(
    "li", { class: `parameter ${stateOf(p)}`, "data-key": p.parameter },
    make("div", {},
      make("button", { type: "button", "data-part": "chart", "aria-pressed": String(p.parameter === parameter), "aria-label": `Chart of ${p.parameter}`, on: { click: pick } }, p.parameter),
      " ", value, ` ${p.unit ?? ""}`),
    make("div", {}, bar(p), make("span", { class: "quiet" }, limit)),
    make("p", {}, make("span", { class: "word" }, words), make("span", { class: "quiet" }, held)),
    make("p", { class: "quiet" }, "reference ", number(p.reference), p.baseline_id === null ? " (nominal)" : ` (baseline ${p.baseline_id})`),
    make("p", { class: "quiet known" }, p.known.words),
  );
}

/** Show what surrounds the rig: the newest reading of each covariate, and which references follow it. */
function showCovariates(rig) {
  const items = rig.covariates.map((c) => make(
    "li", { class: c.stale ? "bad" : "good", "data-key": c.covariate },
    make("p", {}, `${c.covariate}: `, make("span", { class: "word" }, c.value === null ? "not read" : `${number(c.value, 4)} ${c.unit}`),
      c.age_s === null ? "" : `, ${age(c.age_s)} ago`, c.stale ? ", missing" : ""),
    make("p", { class: "quiet" }, c.words),
  ));
  replaceItems(byId("covariate-list"), items.length ? items : [make("li", {}, "no covariate is read")]);
}

function showSources(rig) {
  const items = rig.sources.map((s) => make(
    "li", { class: s.stale ? "bad" : s.dropped || s.rejected || s.gaps ? "doubt" : "good", "data-key": s.source },
    make("p", {}, `${s.source}: `, make("span", { class: "word" }, s.stale ? "silent" : "reads"), ` ${number(s.rate_hz, 4)} samples/s, lag ${number(s.lag_s, 3)} s`),
    make("p", { class: "quiet" }, `received ${s.received}, used ${s.used}, rejected ${s.rejected}, dropped ${s.dropped}, gaps ${s.gaps}`
      + (s.drift_ppm === null ? "" : `; clock ${withSd(s.drift_ppm, s.drift_sd_ppm)} ppm fast`)
      + (s.skew_s === null ? "" : `; ${withSd(1e3 * s.skew_s, 1e3 * s.skew_sd_s)} ms behind the first source`)),
  ));
  replaceItems(byId("source-list"), items.length ? items : [make("li", {}, "no ledger yet")]);
}

/** Take in the rows of one instant without asking again. */
function takeRows(document) {
  const rig = rigs.find((one) => one.db === document.db && one.rig === document.rig);
  if (!rig) { soon(); return; }
  for (const row of document.rows) {
    const p = rig.parameters.find((one) => one.parameter === row.parameter);
    if (!p || row.t_ns < p.t_ns) continue;
    if (row.status !== p.status || row.reason !== p.reason) soon(); // what is known now is said anew
    Object.assign(p, row, { used: p.limit && row.delta !== null ? Math.abs(row.delta) / p.limit : null });
  }
  rig.lag_s = 0;
  if (keyOf(rig) === chosen) chart.news();
  if (!takeRows.waiting) takeRows.waiting = requestAnimationFrame(() => { takeRows.waiting = null; refresh(); });
}

function refresh() {
  const rig = rigs.find((one) => keyOf(one) === chosen);
  if (rig) showParameters(rig);
}

/** Ask for all anew within a fifth of a second, once for any number of reasons. */
function soon() {
  pending ??= setTimeout(() => { pending = null; load(); }, 200);
}

function listen() {
  const source = new EventSource("api/v1/events");
  const state = byId("connection");
  source.addEventListener("hello", () => { state.textContent = "live"; soon(); });
  source.addEventListener("reset", () => { state.textContent = "live"; soon(); });
  source.addEventListener("alarm", soon);
  source.addEventListener("estimates", (event) => takeRows(JSON.parse(event.data)));
  source.addEventListener("error", () => {
    state.textContent = "connection lost, trying again";
    if (source.readyState === EventSource.CLOSED) setTimeout(listen, 5000);
  });
}

addEventListener("deltak-signed-in", soon);
await alarms.start();
await load();
listen();
setInterval(load, EVERY_MS);
