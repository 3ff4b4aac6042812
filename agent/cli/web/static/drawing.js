// The model as masses, springs and dampers, or boxes and blocks of another domain, coloured by their states.
import { draw, stateOf } from "./dom.js";

const STEP = 110, ROW = 34, WIDE = 46, TOP = 20;
const WORDS = { good: "normal", doubt: "cannot tell", bad: "alarm" };

/** Return an SVG of /api/v1/model; states: parameters of the overview by name. */
export function drawing(model, states) {
  const rows = Math.max(2, ...model.elements.map((e) => e.row + 1));
  const height = TOP + rows * ROW + 24;
  const last = Math.max(0, ...model.masses.map((m) => m.place));
  const ofOne = (name) => Object.keys(states).filter((key) => key === name || key.startsWith(`${name}.`)).map((key) => stateOf(states[key]));
  const state = (name) => ["bad", "doubt", "good"].find((look) => name && ofOne(name).includes(look)) ?? "";
  const said = Object.keys(states).map((name) => `${name} ${WORDS[state(name)]}`).join(", ");
  const shapes = model.elements.map((e) => element(e, state(e.name)));
  const boxes = model.masses.map((m) => mass(m, rows, state(m.name)));
  const picture = draw("svg", { viewBox: `0 0 ${last * STEP + 60} ${height}`, role: "img", "aria-label": `Model of the rig: ${said}` });
  const wall = draw("path", { class: "shape", d: `M14 ${TOP - 8}V${TOP + rows * ROW}` });
  picture.append(...(model.elements.some((e) => e.from === 0) ? [wall] : []), ...shapes, ...boxes);
  return picture;
}

const left = (place) => (place === 0 ? 14 : place * STEP - WIDE / 2 + 14);
const right = (place) => (place === 0 ? 14 : place * STEP + WIDE / 2 + 14);

function mass({ name, place }, rows, state) {
  const x = left(place);
  const box = draw("rect", { class: `shape mass ${state}`, x, y: TOP - 8, width: WIDE, height: rows * ROW + 8 });
  return draw("g", {}, box, draw("text", { x: x + WIDE / 2, y: TOP + (rows * ROW) / 2 }, name));
}

function element({ name, kind, from, to, row }, state) {
  const x = right(from), end = left(from + 1), y = TOP + 8 + row * ROW;
  const middle = (x + end) / 2;
  const d = `${(SHAPES[kind] ?? block)(x, end, y)}M${end} ${y}H${Math.max(end, left(to))}`;
  return draw("g", {}, draw("path", { class: `shape ${state}`, d }), draw("text", { x: middle, y: y + 20 }, name));
}

const SHAPES = { spring, damper, friction, wire: (x, end, y) => `M${x} ${y}H${end}` };

function block(x, end, y) {
  const m = (x + end) / 2;
  return `M${x} ${y}H${m - 14}M${m - 14} ${y - 6}H${m + 14}V${y + 6}H${m - 14}ZM${m + 14} ${y}H${end}`;
}

function spring(x, end, y) {
  const first = x + 8, step = (end - x - 16) / 8;
  const turns = Array.from({ length: 7 }, (_, i) => `L${first + (i + 1) * step} ${y + (i % 2 ? 6 : -6)}`);
  return `M${x} ${y}H${first}${turns.join("")}L${end - 8} ${y}H${end}`;
}

function damper(x, end, y) {
  const m = (x + end) / 2;
  return `M${x} ${y}H${m}M${m} ${y - 5}V${y + 5}M${m + 9} ${y - 8}H${m - 9}M${m + 9} ${y + 8}H${m - 9}M${m + 9} ${y - 8}V${y + 8}M${m + 9} ${y}H${end}`;
}

function friction(x, end, y) {
  const m = (x + end) / 2;
  return `M${x} ${y}H${m + 8}M${m - 8} ${y + 5}H${end}M${m - 8} ${y - 5}H${m + 8}`;
}

/** Return the bar of a parameter: its interval between its limits, on a scale around the reference. */
export function bar(p) {
  const values = [p.lower, p.upper, p.value];
  const known = p.reference !== null && values.every((v) => v !== null);
  const picture = draw("svg", { viewBox: "0 0 200 16", preserveAspectRatio: "none", "aria-hidden": "true" });
  picture.append(draw("path", { class: "track", d: "M0 8H200" }));
  if (!known) return picture;
  const reach = p.limit ? 1.25 * p.limit : 1.1 * Math.max(...values.map((v) => Math.abs(v - p.reference))) || 1;
  const place = (v) => 100 + 98 * Math.min(1, Math.max(-1, (v - p.reference) / reach));
  if (p.limit) picture.append(draw("path", { class: "edge", d: `M${place(p.reference - p.limit)} 1V15M${place(p.reference + p.limit)} 1V15` }));
  picture.append(draw("path", { class: "track", d: "M100 3V13" }));
  picture.append(draw("path", { class: "span", d: `M${place(p.lower)} 8H${Math.max(place(p.upper), place(p.lower) + 1)}` }));
  picture.append(draw("circle", { class: "dot", cx: place(p.value), cy: 8, r: 3.5 }));
  return picture;
}
