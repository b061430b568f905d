// The states of alarms: a word, a shape and a colour each, so that no one of them is needed alone.

import { h, svg } from "./dom.js";
import { words } from "./format.js";

// shape: its SVG path in a field of 16 by 16; solid ones call for somebody
const SHAPES = {
  check: "M8 1.5a6.5 6.5 0 1 0 .01 0zM5 8.2l2.2 2.2L11 6",
  diamond: "M8 .8 15.2 8 8 15.2.8 8z",
  triangle: "M8 1.2 15.4 14.5H.6z",
  square: "M2 2h12v12H2z",
  circle: "M8 1.5a6.5 6.5 0 1 0 .01 0z",
};
const MARKS = {
  bang: "M8 4.6v4.2M8 11v.7",
  tick: "M5.3 8.2l1.9 1.9 3.5-3.9",
  back: "M10.8 8H5.4m2-2.2L5.2 8l2.2 2.2",
  bars: "M6.3 5.2v5.6M9.7 5.2v5.6",
  slash: "M4.2 11.8l7.6-7.6",
  none: "",
};

const LOOKS = {
  normal: ["check", "none", "normal", "normal"],
  unacknowledged: ["diamond", "bang", "alarm", "unacknowledged"],
  acknowledged: ["diamond", "tick", "seen", "acknowledged"],
  returned_unacknowledged: ["diamond", "back", "returned", "gone, not acknowledged"],
  shelved: ["square", "bars", "shelved", "shelved"],
  suppressed: ["square", "slash", "off", "suppressed"],
  out_of_service: ["circle", "slash", "off", "out of service"],
};
const RANKS = [
  "normal",
  "out_of_service",
  "suppressed",
  "shelved",
  "acknowledged",
  "returned_unacknowledged",
  "unacknowledged",
];

/** How urgent a state is; the larger, the more. */
export const rank = (state) => RANKS.indexOf(state);

export const worst = (states) => states.reduce((one, other) => (rank(other) > rank(one) ? other : one), "normal");

export const stateWord = (state) => LOOKS[state]?.[3] ?? words(state);

function icon(shape, mark) {
  return svg(
    "svg",
    { viewBox: "0 0 16 16", class: "icon", "aria-hidden": "true" },
    svg("path", { d: SHAPES[shape], class: "shape" }),
    MARKS[mark] && svg("path", { d: MARKS[mark], class: "mark" }),
  );
}

/** The state of an alarm as a mark with its word; a warning is a triangle. */
export function stateBadge(state, severity = "alarm") {
  const [shape, mark, kind, word] = LOOKS[state] ?? ["circle", "none", "off", words(state)];
  const warning = severity === "warning" && shape === "diamond";
  return h(
    "span",
    { class: `badge ${kind}${warning ? " warning" : ""}` },
    icon(warning ? "triangle" : shape, mark),
    h("span", {}, word),
  );
}

/** The mark alone, for where the word stands beside it. */
export function stateIcon(state, severity = "alarm") {
  const badge = stateBadge(state, severity);
  badge.lastChild.className = "hidden";
  return badge;
}

const STATUSES = {
  running: ["check", "none", "normal"],
  completed: ["circle", "none", "off"],
  done: ["check", "none", "normal"],
  silent: ["triangle", "bang", "warning"],
  failed: ["diamond", "bang", "alarm"],
  interrupted: ["triangle", "bang", "warning"],
  queued: ["circle", "bars", "off"],
  cancelled: ["circle", "slash", "off"],
  writing: ["circle", "none", "busy"],
  complete: ["check", "none", "normal"],
  truncated: ["triangle", "bang", "warning"],
  busy: ["circle", "none", "busy"],
  explained: ["check", "none", "normal"],
  no_gap: ["check", "none", "normal"],
  partly_explained: ["triangle", "bang", "warning"],
  unknown: ["diamond", "bang", "warning"],
};

/** The status of a job, with how far it has come. */
export function jobBadge({ status, progress }) {
  if (status !== "running") return statusBadge(status);
  return statusBadge("busy", progress ? `running, ${Math.round(100 * progress)} %` : "running");
}

/** The status of a run, a recording, a verdict. */
export function statusBadge(status, text = words(status)) {
  const [shape, mark, kind] = STATUSES[status] ?? ["circle", "none", "off"];
  return h("span", { class: `badge ${kind}` }, icon(shape, mark), h("span", {}, text));
}
