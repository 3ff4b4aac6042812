// The list of alarms, and what an operator does to them, by mouse or by keyboard alone.
import { ask, byId, instant, make, number, replaceItems } from "./dom.js";

const ORDER = ["UNACK", "ACKED", "RTNUN", "SHLVD", "OOSRV", "DSUPR"];
const WORDS = {
  UNACK: "not acknowledged", ACKED: "acknowledged", RTNUN: "over, not acknowledged", SHLVD: "shelved",
  OOSRV: "out of service", DSUPR: "suppressed by design",
};
const PRIORITIES = ["critical", "high", "medium", "low"];
const SHELF = "8h";

export class Alarms {
  constructor() {
    this.session = { signed_in: false, possible: false };
    byId("alarm-list").addEventListener("keydown", (event) => this.key(event));
    byId("sign").addEventListener("click", () => this.signOrOut());
    byId("sign-dialog").addEventListener("close", () => this.focusAgain());
    byId("sign-cancel").addEventListener("click", () => byId("sign-dialog").close());
    byId("sign-form").addEventListener("submit", (event) => { event.preventDefault(); this.signIn(); });
  }

  async start() {
    this.take(await ask("session"));
  }

  take(session) {
    this.session = session;
    byId("sign").hidden = !session.possible;
    byId("sign").textContent = session.signed_in ? `Sign out ${session.name}` : "Sign in";
  }

  async load() {
    const { alarms } = await ask("alarms?active=1");
    const rank = (a) => [ORDER.indexOf(a.state), PRIORITIES.indexOf(a.priority), -a.id];
    alarms.sort((a, b) => rank(a).map((r, i) => r - rank(b)[i]).find((d) => d) ?? 0);
    replaceItems(byId("alarm-list"), alarms.map((alarm) => this.item(alarm)));
    const open = alarms.filter((a) => a.state === "UNACK").length;
    const count = alarms.length ? `${alarms.length} ${alarms.length === 1 ? "alarm" : "alarms"}, ${open} not acknowledged` : "no alarms";
    if (byId("alarm-count").textContent !== count) byId("alarm-count").textContent = count;
    document.title = open ? `(${open}) deltak` : "deltak";
  }

  item(alarm) {
    const what = `${alarm.kind} alarm ${alarm.id}, ${alarm.parameter} of ${alarm.rig}`;
    const act = (action, words, body) => make(
      "button", { type: "button", "data-part": action, "aria-label": `${words}: ${what}`, on: { click: () => this.act(alarm, action, body) } }, words,
    );
    const buttons = [
      ["UNACK", "RTNUN"].includes(alarm.state) ? act("ack", "Acknowledge", {}) : null,
      ["UNACK", "ACKED", "RTNUN"].includes(alarm.state) ? act("shelve", `Shelve ${SHELF}`, { for: SHELF }) : null,
      alarm.state === "SHLVD" ? act("unshelve", "Unshelve", {}) : null,
    ];
    const look = ["UNACK", "ACKED"].includes(alarm.state) ? "bad" : "doubt";
    const details = [alarm.kind, `${alarm.priority} priority`, alarm.acked_by ? `acknowledged by ${alarm.acked_by}` : ""];
    if (alarm.delta !== null) details.push(`Δ ${number(alarm.delta, 4)}, limit ${number(alarm.limit_value, 4)}`);
    return make(
      "li", { class: look, tabindex: "0", "data-key": `${alarm.db}/${alarm.id}`, "aria-label": `${what}: ${WORDS[alarm.state] ?? alarm.state}` },
      make("p", {}, make("span", { class: "word" }, alarm.state), ` ${alarm.rig} ${alarm.parameter}: `, alarm.message),
      make("p", { class: "quiet" }, details.filter(Boolean).join(" · "), " · raised ", instant(alarm.raised_at)),
      alarm.advice ? make("p", {}, alarm.advice) : null,
      make("div", { class: "bar" }, ...buttons),
    );
  }

  key(event) {
    const item = event.target.closest("li");
    if (!item || event.ctrlKey || event.metaKey || event.altKey) return;
    const press = (part) => item.querySelector(`[data-part="${part}"]`)?.click();
    const acts = {
      ArrowDown: () => item.nextElementSibling?.focus(), ArrowUp: () => item.previousElementSibling?.focus(),
      a: () => press("ack"), s: () => press("shelve"), u: () => press("unshelve"),
    };
    if (!(event.key in acts)) return;
    event.preventDefault();
    acts[event.key]();
  }

  /** Go back to the alarm that was dealt with last, where nothing that is shown has the focus. */
  focusAgain() {
    // a field of a closed dialog stays the active element until the page is drawn next
    const lost = document.activeElement === document.body || document.activeElement.closest("dialog:not([open])");
    if (this.dealtWith && lost) {
      (byId("alarm-list").querySelector(`[data-key="${CSS.escape(this.dealtWith)}"]`) ?? byId("alarms")).focus();
    }
  }

  async act(alarm, action, body) {
    const notice = byId("notice");
    this.dealtWith = `${alarm.db}/${alarm.id}`;
    notice.textContent = "";
    if (!this.session.signed_in) {
      if (!this.session.possible) {
        notice.textContent = "This page only reads: it was started without a password.";
        return;
      }
      this.after = () => this.act(alarm, action, body);
      this.openDialog();
      return;
    }
    try {
      await this.send(`alarms/${encodeURIComponent(alarm.db)}/${alarm.id}/${action}`, "POST", body);
      await this.load();
      this.focusAgain();
    } catch (error) {
      notice.textContent = error.message;
      if (error.status === 401) this.take(await ask("session"));
    }
  }

  send(path, method, body) {
    const headers = { "Content-Type": "application/json", "X-CSRF-Token": this.session.csrf ?? "" };
    return ask(path, { method, headers, body: JSON.stringify(body) });
  }

  async signOrOut() {
    if (this.session.signed_in) this.take(await this.send("session", "DELETE", {}));
    else this.openDialog();
  }

  openDialog() {
    if (byId("sign-dialog").open) return; // somebody is typing
    byId("sign-words").textContent = "";
    byId("sign-dialog").showModal();
    byId("sign-name").focus();
  }

  async signIn() {
    try {
      this.take(await this.send("session", "POST", { name: byId("sign-name").value, password: byId("sign-password").value }));
    } catch (error) {
      byId("sign-words").textContent = error.message;
      return;
    }
    byId("sign-password").value = "";
    byId("sign-dialog").close();
    const after = this.after;
    this.after = null;
    dispatchEvent(new Event("deltak-signed-in"));
    await after?.();
  }
}
