// One parameter over time, from seconds to years: value, interval, extremes, reference, limits, forecast. Drawn by uPlot.
import { ask, byId, make, number, query } from "./dom.js";
import { drawPast, fanOf } from "./fan.js";

const SPANS = [["1 min", 60], ["10 min", 600], ["1 h", 3600], ["1 d", 86400], ["1 week", 604800], ["30 d", 2592000], ["1 year", 31557600], ["all", null]];
const LEAST_S = 2, MOST_S = 50 * 31557600;

export class Chart {
  constructor() {
    this.past = []; // rows of v_forecast but the newest
    this.spread = null; // sd of the healthy machine's estimates about the baseline
    this.shown = null; // {db, rig, parameter, reference, limit, delta}
    this.span = 600;
    this.end = null; // s since the epoch; null follows the newest row
    this.plot = null;
    this.turn = 0;
    this.buttons = SPANS.map(([words, span]) => make("button", { type: "button", "aria-pressed": "false", on: { click: () => this.show(span, null) } }, words));
    this.limits = make("button", { type: "button", "aria-pressed": "true", on: { click: () => this.turnLimits() } }, "limits");
    const move = (words, label, act) => make("button", { type: "button", "aria-label": label, on: { click: act } }, words);
    byId("chart-bar").append(
      ...this.buttons,
      move("◀", "Earlier", () => this.pan(-0.5)), move("▶", "Later", () => this.pan(0.5)),
      move("+", "Zoom in", () => this.zoom(0.5)), move("−", "Zoom out", () => this.zoom(2)), this.limits,
    );
    byId("chart").addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.plot?.setSize(this.size())).observe(byId("chart"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.load());
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const acts = {
      ArrowLeft: () => this.pan(-0.25), ArrowRight: () => this.pan(0.25), "+": () => this.zoom(0.5), "=": () => this.zoom(0.5),
      "-": () => this.zoom(2), Home: () => this.show(null, null), End: () => this.show(this.span, null),
    };
    if (!(event.key in acts)) return;
    event.preventDefault();
    acts[event.key]();
  }

  select(shown) {
    const same = this.shown && ["db", "rig", "parameter"].every((key) => this.shown[key] === shown[key]);
    this.shown = shown;
    if (same) return;
    this.fan = null;
    this.past = [];
    byId("chart-title").textContent = `Chart of ${shown.parameter} of ${shown.rig}`;
    this.load();
    this.forecast(true);
    this.learnt();
  }

  show(span, end) {
    this.span = span;
    this.end = end;
    this.load();
  }

  bounds() {
    const times = this.points?.map((p) => p[0] / 1e9) ?? [];
    const last = this.end ?? times.at(-1) ?? Date.now() / 1e3;
    return [this.span === null ? times[0] ?? last - 60 : last - this.span, last];
  }

  pan(share) {
    const [first, last] = this.bounds();
    this.show(last - first, last + share * (last - first));
  }

  zoom(factor) {
    const [first, last] = this.bounds();
    const span = Math.min(MOST_S, Math.max(LEAST_S, (last - first) * factor));
    this.show(span, this.end === null ? null : (first + last) / 2 + span / 2);
  }

  /** Show the limits, or the value alone on a scale of its own. */
  turnLimits() {
    this.limits.setAttribute("aria-pressed", String(!this.hasLimits()));
    if (this.points) this.draw();
  }

  hasLimits() {
    return this.limits.getAttribute("aria-pressed") === "true";
  }

  /** Return the instants to come of the fan, where it lies within a few times of what is shown; the newest row first. */
  ahead() {
    if (!this.fan || this.end !== null || !this.hasLimits()) return [];
    const newest = Math.max(this.fan.from[0] / 1e9, (this.points.at(-1)?.[0] ?? 0) / 1e9);
    const times = this.fan.times.filter((t) => t > newest);
    const isNear = this.span === null || times.at(-1) - newest < 3 * this.span;
    return times.length && isNear ? [newest, ...times] : [];
  }

  /** Take in that new rows came: what is followed is read anew, but not more often than a pixel needs. */
  news() {
    if (this.end !== null || this.waiting) return;
    const pause = Math.min(60000, Math.max(500, ((this.span ?? 86400) * 1000) / 600));
    this.waiting = setTimeout(() => { this.waiting = null; this.load(); }, pause);
  }

  async load() {
    if (!this.shown) return;
    const turn = ++this.turn;
    const { db, rig, parameter } = this.shown;
    const range = this.end === null
      ? { since: this.span === null ? null : `${this.span}s` }
      : { since: iso(this.end - this.span), until: iso(this.end) };
    try {
      const found = await ask(`points?${query({ db, rig, parameter, points: 600, ...range })}`);
      if (turn !== this.turn) return; // another range was asked for meanwhile
      this.points = found.points;
      this.unit = found.unit;
      this.draw();
      this.say(found);
    } catch (error) {
      byId("chart-words").textContent = error.message;
    }
  }

  /** Take in the stored forecasts of what is shown, or where there is none, one that is made now. */
  async forecast(anew = false) {
    if (!this.shown) return;
    const shown = this.shown;
    const { db, rig, parameter } = shown;
    const isOther = () => ["db", "rig", "parameter"].some((key) => this.shown[key] !== shown[key]);
    try {
      const { forecasts } = await ask(`forecasts?${query({ db, rig, parameter })}`);
      const newest = forecasts.at(-1);
      if (isOther() || (!anew && newest?.id === this.newest)) return;
      const fan = await fanOf(shown, newest);
      if (isOther()) return;
      this.newest = newest?.id;
      this.past = forecasts.slice(0, -1).filter((row) => row.p50_ns !== null);
      this.fan = fan;
      if (this.points) this.draw();
    } catch { /* no forecast is drawn where none can be made; the list of forecasts has its words */ }
  }

  /** Take in what the healthy machine's estimates spread by, where the reference is a baseline. */
  async learnt() {
    const { db, rig, parameter, baseline_id: learntAs } = this.shown;
    this.spread = null;
    if (learntAs === null) return;
    const { baselines } = await ask(`baselines?${query({ db, rig })}`);
    if (this.shown.parameter !== parameter) return;
    this.spread = baselines.find((one) => one.baseline_id === learntAs)?.spread_sd ?? null;
    if (this.points) this.draw();
  }

  say(found) {
    this.buttons.forEach((button, i) => button.setAttribute("aria-pressed", String(this.end === null && SPANS[i][1] === this.span)));
    const lowest = Math.min(...found.points.map((p) => p[3])), highest = Math.max(...found.points.map((p) => p[4]));
    byId("chart-words").textContent = found.newest
      ? `${found.n} rows; newest ${number(found.newest[1])} ${found.unit}, from ${number(lowest, 4)} to ${number(highest, 4)}`
      : "no valid rows in that time";
  }

  size() {
    return { width: Math.max(200, byId("chart").clientWidth), height: 240 };
  }

  draw() {
    const css = getComputedStyle(document.documentElement);
    const colour = (name) => css.getPropertyValue(`--${name}`).trim();
    const { data, series, bands } = this.columns(colour);
    const axis = { stroke: colour("text"), grid: { stroke: `${colour("line")}55` }, ticks: { stroke: colour("line") } };
    this.plot?.destroy();
    const options = {
      ...this.size(), series, bands, axes: [axis, { ...axis, size: 62, label: this.unit, labelSize: 18 }],
      cursor: { drag: { x: true, y: false, setScale: false } }, legend: { live: false },
      hooks: { setSelect: [(plot) => this.dragged(plot)], draw: [(plot) => this.hasLimits() && drawPast(plot, this.past, colour("fan"))] },
    };
    this.plot = new uPlot(options, data, byId("chart"));
  }

  dragged(plot) {
    if (plot.select.width < 5) return;
    const [first, last] = [plot.select.left, plot.select.left + plot.select.width].map((x) => plot.posToVal(x, "x"));
    this.show(Math.max(LEAST_S, last - first), last);
  }

  /** Return uPlot's columns: the points, and behind them the forecast's, which have none of the others. */
  columns(colour) {
    const ahead = this.ahead();
    const x = [...this.points.map((p) => p[0] / 1e9), ...ahead];
    const past = (of) => [...this.points.map(of), ...ahead.map(() => null)];
    const flat = (value) => x.map(() => value);
    const { reference, limit } = this.shown;
    const line = (label, stroke, values, more = {}) => ({ values, options: { label, stroke, points: { show: false }, ...more } });
    const lines = [
      line("95 % high", `${colour("mark")}66`, past((p) => p[1] + 1.96 * p[2])),
      line("95 % low", `${colour("mark")}66`, past((p) => p[1] - 1.96 * p[2])),
      line("value", colour("mark"), past((p) => p[1]), { width: 2 }),
      line("highest", colour("quiet"), past((p) => p[4]), { dash: [2, 4] }),
      line("lowest", colour("quiet"), past((p) => p[3]), { dash: [2, 4] }),
    ];
    const bands = [{ series: [1, 2], fill: `${colour("mark")}2a` }];
    const between = (low, high, fill) => { bands.push({ series: [lines.length + 1, lines.length + 2], fill: `${fill}1c` }); lines.push(high, low); };
    if (reference !== null && this.hasLimits()) {
      const edge = (words, way, stroke, dash) => line(words, stroke, flat(reference + way), { dash });
      lines.push(edge(this.shown.baseline_id === null ? "nominal" : `baseline ${this.shown.baseline_id}`, 0, colour("quiet"), [8, 4]));
      if (this.spread) between(...[-2, 2].map((n) => edge("healthy, 2 sd", n * this.spread, `${colour("good")}88`, [2, 2])), colour("good"));
      const sides = limit ? { low: [-1], high: [1] }[this.shown.side] ?? [-1, 1] : [];
      const limits = sides.map((way) => edge("limit", way * limit, colour("bad"), [4, 2]));
      if (limits.length === 2) between(...limits, colour("quiet"));
      else lines.push(...limits);
    }
    if (ahead.length) bands.push({ series: [lines.length + 3, lines.length + 1], fill: `${colour("fan")}2a` });
    for (const [i, end] of ahead.length ? this.fan.times.entries() : []) {
      const [start, value] = [this.fan.from[0] / 1e9, this.fan.from[1]];
      const at = (t) => value + (this.fan.limit - value) * Math.min(1, (t - start) / (end - start));
      const values = [...this.points.map(() => null), ...ahead.map(at)];
      lines.push(line(["P10", "P50", "P90"][i], colour("fan"), values, { dash: i === 1 ? [] : [3, 3] }));
    }
    return { data: [x, ...lines.map((l) => l.values)], series: [{}, ...lines.map((l) => l.options)], bands };
  }
}

const iso = (seconds) => new Date(Math.round(seconds * 1e3)).toISOString();
