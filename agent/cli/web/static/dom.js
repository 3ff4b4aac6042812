// What all parts of the page share. Text from the database becomes text nodes, never markup.
const SVG = "http://www.w3.org/2000/svg";

export const byId = (id) => document.getElementById(id);

/** Make an element: attributes by name, `on` functions by event, children as nodes or text. */
export function make(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

export function draw(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

function filled(element, { on = {}, ...attributes }, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  for (const [name, act] of Object.entries(on)) element.addEventListener(name, act);
  element.append(...children.filter((child) => child !== null).map((child) => (child instanceof Node ? child : String(child))));
  return element;
}

/** Replace a list's items; the item with the focus is found again by its key, so that a keyboard stays where it was. */
export function replaceItems(list, items) {
  const focused = list.contains(document.activeElement) ? document.activeElement : null;
  const key = focused?.closest("[data-key]")?.dataset.key;
  const part = focused?.dataset.part;
  list.replaceChildren(...items);
  if (key === undefined) return;
  const item = items.find((one) => one.dataset.key === key);
  const inside = () => item.querySelector(`[data-part="${CSS.escape(part ?? "")}"]`) ?? item.querySelector("button");
  const wasItem = focused.dataset.key === key;
  if (item) (wasItem ? item : inside() ?? item).focus();
}

/** Ask the API; raises an Error with the words of what is wrong. */
export async function ask(path, options = {}) {
  const answer = await fetch(`api/v1/${path}`, { credentials: "same-origin", ...options });
  const content = await answer.json();
  if (answer.ok) return content;
  const words = (content.errors ?? []).map((e) => [e.path, e.message].filter(Boolean).join(": ") + (e.advice ? `; ${e.advice}` : ""));
  throw Object.assign(new Error(words.join("\n") || `error ${answer.status}`), { status: answer.status });
}

export const query = (values) => new URLSearchParams(Object.entries(values).filter(([, value]) => value !== null && value !== undefined));

/** Write a number to so many digits; a dash for none. */
export function number(value, digits = 6) {
  return value === null || value === undefined ? "–" : String(Number(value.toPrecision(digits)));
}

/** Write value ± sd to the digits that the deviation allows. */
export function withSd(value, sd) {
  if (value === null || !(sd > 0)) return number(value);
  const power = Math.floor(Math.log10(sd));
  const decimals = (sd / 10 ** power < 2.95 ? 1 : 0) - power;
  const size = Math.floor(Math.log10(Math.max(Math.abs(value), sd)));
  if (size < -4 || size >= 7) return `${value.toPrecision(4)} ± ${sd.toPrecision(2)}`;
  return decimals < 0 ? `${Math.round(value)} ± ${Math.round(sd)}` : `${value.toFixed(decimals)} ± ${sd.toFixed(decimals)}`;
}

/** Write an instant in the time of whoever reads; the document's own text is its title. */
export function instant(text) {
  return text ? make("time", { datetime: text, title: text }, new Date(text.slice(0, 23) + "Z").toLocaleString()) : "";
}

export function age(seconds) {
  const units = [["d", 86400], ["h", 3600], ["min", 60]];
  const [unit, size] = units.find(([, s]) => seconds >= 2 * s) ?? ["s", 1];
  return `${Math.max(0, Math.round(seconds / size))} ${unit}`;
}

/** Return "good", "doubt" or "bad" for a parameter of the overview. */
export function stateOf(parameter) {
  if (["UNACK", "ACKED"].includes(parameter.alarm)) return "bad";
  return parameter.status === "valid" && !parameter.alarm ? "good" : "doubt";
}
