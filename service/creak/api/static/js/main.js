// The page: which view is shown, how the service is heard, what is said about it all.

import { announce, askForKey } from "./dialogs.js";
import { h, replace } from "./dom.js";
import { clock, words } from "./format.js";
import { Problem, askWith, forgetKey, key } from "./http.js";
import { hear, live, stale, start, subscribe } from "./live.js";
import { resolve, route } from "./router.js";
import { help, install } from "./shortcuts.js";
import { chosen, turn } from "./theme.js";
import { alarm, alarms } from "./views/alarms.js";
import { diagnoses, diagnosis } from "./views/diagnoses.js";
import { fleet } from "./views/fleet.js";
import { job } from "./views/jobs.js";
import { node } from "./views/node.js";
import { recordings } from "./views/recordings.js";
import { rig } from "./views/rig.js";
import { webhooks } from "./views/webhooks.js";

for (const [pattern, view] of Object.entries({
  "/": fleet,
  "/rigs/:rig": rig,
  "/rigs/:rig/nodes/:node": node,
  "/alarms": alarms,
  "/alarms/:id": alarm,
  "/recordings": recordings,
  "/jobs/:id": job,
  "/diagnoses": diagnoses,
  "/diagnoses/:id": diagnosis,
  "/webhooks": webhooks,
}))
  route(pattern, view);

const main = document.getElementById("main");
let shown = 0; // counts what was shown, so that a view that comes late is dropped
let current = null;

async function show({ focus = true } = {}) {
  const number = ++shown;
  current?.close();
  current = null;
  const place = h("div", { class: "view" }, h("p", { class: "loading", role: "status" }, "loading …"));
  main.replaceChildren(place);
  for (const link of document.querySelectorAll("nav a")) {
    const inside =
      link.hash === "#/" ? /^#?\/?$|^#\/rigs\//.test(location.hash) : location.hash.startsWith(link.hash);
    if (inside) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  try {
    const found = resolve(location.hash);
    if (!found) throw new Error("There is no such page.");
    const view = h("div", { class: "view" });
    const made = await found.view(view, found.parameters);
    if (number !== shown) {
      made.close();
      return;
    }
    place.replaceWith(view);
    current = made;
  } catch (error) {
    if (number !== shown) return;
    place.replaceChildren(
      h(
        "h1",
        { tabindex: "-1" },
        error instanceof Problem && error.status === 404 ? "Not found" : "This cannot be shown",
      ),
      h("p", { class: "complaint" }, error.message),
      h(
        "p",
        { class: "buttons" },
        h("button", { type: "button", onclick: () => show() }, "Try again"),
        h("a", { class: "button", href: "#/" }, "Fleet"),
      ),
    );
  }
  title();
  if (focus) main.querySelector("h1")?.focus({ preventScroll: true });
  scrollTo(0, 0);
}

const urgent = () =>
  live.alarms.filter(({ state }) => state === "unacknowledged" || state === "returned_unacknowledged").length;

function title() {
  const number = urgent();
  const name = main.querySelector("h1")?.textContent ?? "";
  document.title = `${number ? `(${number}) ` : ""}${name ? `${name} – ` : ""}creak`;
}

function showState() {
  const state = document.getElementById("state");
  const number = urgent();
  document.body.classList.toggle("stale", stale());
  state.className = live.connected ? "live" : "waiting";
  replace(state, live.connected ? "live" : live.loaded ? "not connected" : "connecting");
  const badge = document.getElementById("alarm-count");
  badge.hidden = !number;
  replace(badge, String(number), h("span", { class: "hidden" }, " to be acknowledged"));
  document.getElementById("key").hidden = !key();
  const banner = document.getElementById("banner");
  const cut = !live.connected && live.since !== null;
  const since = live.since && clock(new Date(live.since).toISOString());
  const text = cut
    ? `Not connected since ${since}. What is shown is as it was then; the connection is tried again all the time.`
    : live.problem
      ? `Not up to date: ${live.problem.message}.`
      : "";
  banner.hidden = !text;
  replace(banner, text);
  title();
}

askWith(askForKey);
hear((kind, alarmed) => {
  if (kind === "alarm") announce(`Alarm of ${alarmed.rig}, node ${alarmed.node}: ${words(alarmed.event)}`);
});

const themeButton = document.getElementById("theme");
function turnTheme() {
  announce(`colours: ${turn()}`);
  nameTheme();
}
function nameTheme() {
  const name = { auto: "as the system", dark: "dark", light: "light" }[chosen()];
  themeButton.setAttribute("aria-label", `Colours: ${name}. Change`);
  themeButton.title = `Colours: ${name} (t)`;
}
themeButton.addEventListener("click", turnTheme);
nameTheme();
document.getElementById("help").addEventListener("click", help);
document.getElementById("key").addEventListener("click", () => {
  forgetKey();
  location.reload();
});
document.getElementById("skip").addEventListener("click", (event) => {
  event.preventDefault();
  main.querySelector("h1")?.focus();
});
install(turnTheme);
addEventListener("hashchange", () => show());
subscribe(showState);
start();
show({ focus: false });
