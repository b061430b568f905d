// The structure as its network: nodes, what joins them, the ground, and which elements the distortion acts in.

import { h, svg } from "./dom.js";
import { decibels, percent } from "./format.js";
import { to } from "./router.js";
import { stateWord } from "./states.js";

const GROUND = "ground";
const STEP = 130; // between nodes that have no position
const EDGE = 90; // left and right of the outer nodes
const [BASE, FLOOR, HIGHEST] = [120, 214, 100]; // where nodes and ground lie, and how far arcs rise
const STEPS = [0.05, 0.25, 0.5, 0.75]; // of shares: where the next colour begins

/** The colour step of a share, 0 to 4. */
export const shareStep = (share) => STEPS.filter((limit) => share >= limit).length;

const short = (name) => (name.length > 12 ? `${name.slice(0, 11)}…` : name);

/** Draws a rig. nodes: with alarm and levels; elements: { between, share }; nodes are links to their views. */
export function drawStructure({ rig, structure, nodes, elements }) {
  const width = Math.max(520, 2 * EDGE + STEP * (structure.nodes.length - 1));
  const span = width - 2 * EDGE;
  const along = structure.length;
  const at = new Map(
    structure.nodes.map((node, i) => [
      node.name,
      EDGE +
        span *
          (along && node.position !== null
            ? node.position / along
            : structure.nodes.length > 1
              ? i / (structure.nodes.length - 1)
              : 0.5),
    ]),
  );
  const levels = new Map(nodes.map((node) => [node.name, node]));
  const shares = new Map(elements.map((element) => [pairKey(element.between), element]));
  const pairs = new Map(structure.edges.map((pair) => [pairKey(pair), pair]));
  for (const { between } of elements) pairs.set(pairKey(between), between);
  const order = structure.nodes.map((node) => node.name);
  const drawn = [...pairs].sort(
    ([one], [other]) => (shares.get(one)?.share ?? 0) - (shares.get(other)?.share ?? 0),
  );
  const label = `${rig}: ${structure.nodes.length} nodes. ${
    elements.length
      ? elements.map(({ between, share }) => `${between.join(" to ")} ${percent(share)}`).join(", ")
      : "No distortion is located."
  }`;
  return h(
    "div",
    { class: "drawing", tabindex: "0", role: "region", "aria-label": `Structure of ${rig}` },
    svg(
      "svg",
      {
        viewBox: `0 0 ${width} 262`,
        role: "group",
        "aria-label": label,
        class: "structure",
        "data-wide": width > 900,
      },
      along ? beam(width, along) : structure.dense && body(width),
      floor(width),
      drawn.map(([key, pair]) => edge(pair, at, order, shares.get(key), along)),
      structure.nodes.map((node) => nodeMark(rig, node, at.get(node.name), levels.get(node.name))),
    ),
  );
}

const pairKey = (pair) => JSON.stringify([...pair].sort());

function beam(width, length) {
  return [
    svg("rect", { x: EDGE - 14, y: BASE - 5, width: width - 2 * EDGE + 28, height: 10, rx: 3, class: "beam" }),
    svg("text", { x: width - 12, y: FLOOR + 26, class: "note end" }, `beam of ${length} m`),
  ];
}

/** What joins the nodes where that is not known: anything. */
function body(width) {
  return [
    svg("path", { d: `M${EDGE} ${BASE}H${width - EDGE}`, class: "body" }),
    svg("text", { x: width - 12, y: FLOOR + 26, class: "note end" }, "any node may act on any other"),
  ];
}

function floor(width) {
  const hatches = Array.from(
    { length: Math.floor((width - 20) / 14) },
    (_, i) => `M${16 + 14 * i} ${FLOOR + 10}l8 -10`,
  );
  return [
    svg("path", { d: `M10 ${FLOOR}H${width - 10}${hatches.join("")}`, class: "floor" }),
    svg("text", { x: 12, y: FLOOR + 26, class: "note" }, "ground"),
  ];
}

function edge(pair, at, order, element, along) {
  const share = element?.share ?? 0;
  const kind = `edge share-${shareStep(share)}`;
  const named = svg(
    "title",
    {},
    `${pair.join(" – ")}: ${element ? percent(share) : "no"} distortion${
      element && !element.separable ? ", not separable from its neighbours" : ""
    }`,
  );
  const text = (x, y, form = "share") =>
    element && svg("text", { x, y, class: form }, `${percent(share)}${element.separable ? "" : " ?"}`);
  if (pair.includes(GROUND)) {
    const x = at.get(pair.find((name) => name !== GROUND));
    if (x === undefined) return null;
    const zigzag = Array.from({ length: 6 }, (_, i) => `L${x + (i % 2 ? -9 : 9)} ${BASE + 40 + 8 * i}`).join("");
    return svg(
      "g",
      { class: kind },
      named,
      svg("path", { d: `M${x} ${BASE + 20}V${BASE + 36}${zigzag}L${x} ${BASE + 84}V${FLOOR}` }),
      text(x + 18, BASE + 64, "share beside"),
    );
  }
  const [x0, x1] = pair.map((name) => at.get(name)).sort((one, other) => one - other);
  if (x0 === undefined || x1 === undefined) return null;
  const middle = (x0 + x1) / 2;
  const next = Math.abs(order.indexOf(pair[0]) - order.indexOf(pair[1])) === 1;
  if (next) {
    return svg(
      "g",
      { class: `${kind}${along ? " on-beam" : ""}` },
      named,
      svg("path", { d: `M${x0} ${BASE}H${x1}` }),
      text(middle, BASE - 12),
    );
  }
  const rise = Math.min(HIGHEST, 44 + 12 * Math.abs(order.indexOf(pair[0]) - order.indexOf(pair[1])));
  return svg(
    "g",
    { class: kind },
    named,
    svg("path", { d: `M${x0} ${BASE}Q${middle} ${BASE - 2 * rise} ${x1} ${BASE}` }),
    text(middle, BASE - rise - 4),
  );
}

function nodeMark(rig, { name, driven }, x, node) {
  const state = node?.alarm ?? "normal";
  const ratio = decibels(node?.total_to_noise_db ?? null, "dB");
  const known = node && (node.total_to_noise_db ?? node.classical_total_to_noise_db) !== null;
  const link = svg(
    "a",
    {
      href: to("rigs", rig, "nodes", name),
      class: `node ${known ? state : "unknown"}`,
      "data-key": `node ${name}`,
      "aria-label": `Node ${name}: ${known ? stateWord(state) : "no levels yet"}, total over noise ${ratio}`,
    },
    svg("title", {}, `${name}: ${stateWord(state)}`),
    svg("rect", { x: x - 36, y: BASE - 58, width: 72, height: 90, class: "touch" }),
    state === "normal"
      ? svg("circle", { cx: x, cy: BASE, r: 20, class: "shape" })
      : svg("path", { d: `M${x} ${BASE - 28}l28 28l-28 28l-28 -28z`, class: "shape" }),
    svg("text", { x, y: BASE + 5, class: "name" }, short(name)),
    svg("text", { x, y: BASE - 42, class: "level" }, ratio),
  );
  if (!driven) return link;
  return [
    svg("path", { d: `M${x} ${BASE - 92}v22m-5 -7l5 8l5 -8`, class: "input" }),
    svg("text", { x: x + 10, y: BASE - 80, class: "note" }, "input"),
    link,
  ];
}

/** What the colours of the elements mean. */
export function shareKey() {
  return h(
    "p",
    { class: "key" },
    "Element: share of the distortion's force power",
    [0, 5, 25, 50, 75].map((percents, i) =>
      h(
        "span",
        {},
        svg(
          "svg",
          { viewBox: "0 0 28 10", class: `sample edge share-${i}`, "aria-hidden": "true" },
          svg("path", { d: "M0 5h28" }),
        ),
        i ? `from ${percents} %` : "none",
      ),
    ),
  );
}
