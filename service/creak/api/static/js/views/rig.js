// One rig: its structure with the places that distort, its nodes, its data.

import { drawStructure, shareKey } from "../structure.js";
import { alarmTable } from "./alarms.js";
import { facts, h, replace, section, table } from "../dom.js";
import { clock, count, decibels, duration, percent, place, probability, words } from "../format.js";
import { alarmOf, changesPicture, condition, hear, live, readPicture, subscribe } from "../live.js";
import { to } from "../router.js";
import { stateBadge, statusBadge } from "../states.js";

/** Levels of nodes as a table, networked beside classical. */
export function nodeTable(rig, nodes) {
  return table(
    [
      {
        head: "Node",
        cell: (node) =>
          h("a", { href: to("rigs", rig, "nodes", node.name), "data-key": `row ${node.name}` }, node.name),
      },
      { head: "Alarm", cell: (node) => stateBadge(node.alarm, alarmOf(rig, node.name)?.severity) },
      { head: "Signal", cell: (node) => decibels(node.signal_db), number: true, hint: "dB re 1 unit²" },
      { head: "Noise", cell: (node) => decibels(node.noise_db), number: true, hint: "networked, dB re 1 unit²" },
      { head: "Total", cell: (node) => decibels(node.total_db), number: true, hint: "networked, dB re 1 unit²" },
      {
        head: "Nonlinear",
        cell: (node) => decibels(node.nonlinear_db),
        number: true,
        hint: "networked, dB re 1 unit²",
      },
      {
        head: "Total / noise",
        cell: (node) => h("strong", {}, decibels(node.total_to_noise_db, "dB")),
        number: true,
        hint: "networked",
      },
      {
        head: "Classical",
        cell: (node) => decibels(node.classical_total_to_noise_db, "dB"),
        number: true,
        hint: "total over noise, classical",
      },
      {
        head: "p",
        cell: (node) => probability(node.p_value),
        number: true,
        hint: "probability of such a node if the structure is linear",
      },
    ],
    nodes,
    {
      caption: `Levels of the nodes of ${rig}`,
      empty: "No levels yet.",
      mark: (node) => (node.alarm === "unacknowledged" ? "active" : null),
    },
  );
}

export async function rig(root, { rig: name }) {
  await readPicture(name);
  const [head, alarms, drawing, found, nodes, data] = Array.from({ length: 6 }, () => h("div"));
  root.append(
    h("p", { class: "crumbs" }, h("a", { href: "#/" }, "Fleet")),
    head,
    alarms,
    section("Structure", drawing, shareKey(), found),
    section("Nodes", nodes),
    section("Data", data),
  );

  function show() {
    const known = live.rigs.get(name);
    if (!known) return;
    const { status, silence } = condition(known);
    const levels = live.nodes.get(name) ?? [];
    const { structure, elements } = live.pictures.get(name);
    replace(
      head,
      h(
        "div",
        { class: "title" },
        h("h1", { tabindex: "-1", "data-key": "title" }, name),
        statusBadge(status, status === "silent" ? `silent for ${duration(silence)}` : status),
      ),
    );
    const standing = live.alarms.filter((alarm) => alarm.rig === name);
    replace(
      alarms,
      standing.length ? h("section", { class: "card urgent" }, h("h2", {}, "Alarms"), alarmTable(standing)) : null,
    );
    replace(drawing, drawStructure({ rig: name, structure, nodes: levels, elements: elements.items }));
    replace(found, elementText(elements));
    replace(nodes, nodeTable(name, levels));
    replace(data, dataFacts(known, live.details.get(name)));
  }
  show();
  const ends = [
    subscribe(show),
    hear((kind, event) => changesPicture(kind, event) && event.rig === name && readPicture(name)),
  ];
  return { close: () => ends.forEach((end) => end()) };
}

function elementText({ items, located, unavailable, remarks, time }) {
  const notes = [...unavailable, ...remarks].map((note) => h("li", {}, note));
  if (!time) return h("p", { class: "empty" }, "No realisation is complete yet.");
  return [
    items.length
      ? table(
          [
            { head: "Distortion acts between", cell: ({ between }) => place(between) },
            { head: "Share of its power", cell: ({ share }) => percent(share), number: true },
            { head: "Confidence", cell: ({ confidence }) => percent(confidence), number: true },
            {
              head: "Remark",
              quiet: true,
              cell: ({ separable }) => (separable ? "" : "not separable from its neighbours"),
            },
          ],
          items,
          { caption: "Elements that distort" },
        )
      : h(
          "p",
          { class: "hint" },
          located ? "No element distorts." : "Distortion cannot be located with these data.",
        ),
    notes.length ? h("ul", { class: "hint" }, notes) : null,
  ];
}

function dataFacts(known, detail) {
  const faults = Object.entries(known.faults)
    .map(([kind, number]) => count(number, words(kind), words(kind)))
    .join(", ");
  return [
    facts([
      ["source", known.source],
      ["recorded", `${clock(known.start)} to ${clock(known.last)}`],
      ["realisations", known.realisations],
      ["frames", known.frames],
      ["rejected", known.rejected_frames],
      ["transient", known.transient_frames],
      ["faults", faults || "none"],
      [
        "period",
        detail &&
          `${Number((detail.period_samples / detail.sample_rate).toPrecision(4))} s, ${detail.lines} lines`,
      ],
      ["window", detail && count(detail.window, "realisation")],
      [
        "alarm from",
        detail?.limits.total_to_noise_db !== undefined &&
          detail &&
          `${detail.limits.total_to_noise_db} dB, ${detail.limits.exceeding} of ${detail.limits.windows} windows`,
      ],
      ["software", known.software],
    ]),
    known.message && h("p", { class: "complaint" }, known.message),
    detail?.quality.length
      ? h(
          "ul",
          {},
          detail.quality.map(({ kind, message, findings }) =>
            h("li", {}, `${words(kind)}: ${message} (${count(findings, "finding")})`),
          ),
        )
      : null,
    detail?.recent_faults.length
      ? h(
          "details",
          {},
          h("summary", {}, "Newest faults"),
          table(
            [
              { head: "When", cell: ({ time }) => clock(time) },
              { head: "What", cell: ({ kind }) => words(kind) },
              { head: "Message", cell: ({ message }) => h("span", { class: "comment" }, message) },
            ],
            detail.recent_faults,
            { caption: "Newest faults" },
          ),
        )
      : null,
  ];
}
