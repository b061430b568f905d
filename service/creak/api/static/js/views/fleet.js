// All rigs and nodes at a glance, and what needs somebody.

import { drawStructure } from "../structure.js";
import { alarmTable } from "./alarms.js";
import { h, replace } from "../dom.js";
import { count, decibels, duration } from "../format.js";
import { alarmOf, attempt, changesPicture, condition, hear, live, readPicture, subscribe } from "../live.js";
import { to } from "../router.js";
import { rank, stateIcon, stateWord, statusBadge, worst } from "../states.js";

const MANY = 8; // rigs from which on they can be searched
const FEW = 2; // rigs up to which they are drawn

export function fleet(root) {
  const search = h("input", {
    type: "search",
    placeholder: "Find a rig or node",
    "aria-label": "Find a rig or node",
    hidden: true,
  });
  const summary = h("p", { class: "lead" });
  const attention = h("div");
  const cards = h("div", { class: "cards" });
  root.append(
    h("div", { class: "title" }, h("h1", { tabindex: "-1" }, "Fleet"), search),
    summary,
    attention,
    cards,
  );
  const asked = new Set(); // rigs that are drawn
  search.addEventListener("input", show);

  function show() {
    if (!live.loaded) return;
    const rigs = [...live.rigs.values()];
    const few = rigs.length <= FEW;
    for (const { name } of few ? rigs : []) {
      if (asked.has(name)) continue;
      asked.add(name);
      attempt(() => readPicture(name));
    }
    search.hidden = rigs.length < MANY;
    const urgent = live.alarms.filter(({ state }) =>
      ["unacknowledged", "returned_unacknowledged"].includes(state),
    );
    summary.textContent = `${count(rigs.length, "rig")}, ${count(
      rigs.reduce((sum, rig) => sum + rig.nodes.length, 0),
      "node",
    )}, ${urgent.length ? `${count(urgent.length, "alarm")} to be acknowledged` : "nothing to be acknowledged"}`;
    replace(
      attention,
      urgent.length
        ? h(
            "section",
            { class: "card urgent" },
            h("h2", {}, "Needs attention"),
            alarmTable(urgent.slice(0, 5)),
            urgent.length > 5 && h("p", {}, h("a", { href: to("alarms") }, `all ${urgent.length} alarms`)),
          )
        : null,
    );
    const wanted = search.hidden ? "" : search.value.trim().toLowerCase();
    const shown = rigs.filter((rig) =>
      [rig.name, ...rig.nodes].some((name) => name.toLowerCase().includes(wanted)),
    );
    shown.sort(
      (one, other) =>
        urgency(other) - urgency(one) || one.name.localeCompare(other.name, undefined, { numeric: true }),
    );
    cards.classList.toggle("few", few);
    replace(
      cards,
      shown.length
        ? shown.map((rig) => card(rig, few && live.pictures.get(rig.name)))
        : h(
            "p",
            { class: "empty" },
            rigs.length
              ? "No rig has such a name."
              : "No rig has been heard of yet. A service file names them: creak serve creak.toml",
          ),
    );
  }
  show();
  const ends = [
    subscribe(show),
    hear((kind, event) => changesPicture(kind, event) && asked.has(event.rig) && readPicture(event.rig)),
  ];
  return { close: () => ends.forEach((end) => end()) };
}

const urgency = (rig) => rank(worst(Object.values(rig.alarms)));

function card(rig, picture) {
  const { status, silence } = condition(rig);
  const nodes = new Map((live.nodes.get(rig.name) ?? []).map((node) => [node.name, node]));
  const faults = Object.values(rig.faults).reduce((sum, number) => sum + number, 0);
  return h(
    "article",
    { class: `card rig ${status}` },
    h("h2", {}, h("a", { href: to("rigs", rig.name), "data-key": `rig ${rig.name}` }, rig.name)),
    h(
      "p",
      { class: "status" },
      statusBadge(status, status === "silent" ? `silent for ${duration(silence)}` : status),
      h("span", {}, rig.source),
      status !== "silent" &&
        silence !== null &&
        h("span", {}, silence < 10 ? "heard just now" : `heard ${duration(silence)} ago`),
    ),
    picture &&
      drawStructure({
        rig: rig.name,
        structure: picture.structure,
        nodes: [...nodes.values()],
        elements: picture.elements.items,
      }),
    h(
      "ul",
      { class: "tiles" },
      rig.nodes.map((name) => tile(rig, name, nodes.get(name))),
    ),
    rig.message && h("p", { class: "complaint" }, rig.message),
    h(
      "p",
      { class: "hint" },
      [
        count(rig.realisations, "realisation"),
        `${rig.frames} frames`,
        rig.rejected_frames && `${rig.rejected_frames} rejected`,
        faults && count(faults, "fault"),
        "figures: total over noise",
      ]
        .filter(Boolean)
        .join(" · "),
    ),
  );
}

/** Total over noise of a node, the classical one where nothing else can be had. */
function ratio({ total_to_noise_db: networked, classical_total_to_noise_db: classical }) {
  return networked === null ? `${decibels(classical, "dB")} classical` : decibels(networked, "dB");
}

function tile(rig, name, node) {
  const state = rig.alarms[name] ?? "normal";
  const known = node && (node.total_to_noise_db ?? node.classical_total_to_noise_db) !== null;
  const severity = alarmOf(rig.name, name)?.severity;
  return h(
    "li",
    {},
    h(
      "a",
      { class: `tile ${state}`, href: to("rigs", rig.name, "nodes", name), "data-key": `${rig.name} ${name}` },
      stateIcon(known || state !== "normal" ? state : "unknown", severity),
      h("span", { class: "name" }, h("span", { class: "hidden" }, "node "), name),
      h("span", { class: "figure" }, known ? ratio(node) : "no levels yet"),
      state !== "normal" && h("span", { class: "word" }, stateWord(state)),
    ),
  );
}
