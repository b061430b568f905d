// The history of a node's levels, with its alarms, the limit and what was learnt as its baseline.

import { chart } from "./charts.js";
import { h } from "./dom.js";
import { clock } from "./format.js";
import { all, get, path } from "./http.js";

export const MOST = 3000; // points of a chart
const MARKED = 12; // alarms whose journal is read

const RATIOS = [
  { key: "total_to_noise_db", label: "networked", colour: "total", width: 2 },
  { key: "classical_total_to_noise_db", label: "classical", colour: "signal", width: 1, dash: [6, 3] },
];
const LEVELS = [
  { key: "signal_db", label: "signal", colour: "signal", width: 1 },
  { key: "total_db", label: "total", colour: "total", width: 1.5 },
  { key: "noise_db", label: "noise", colour: "noise", width: 1.5, dash: [6, 3] },
  { key: "nonlinear_db", label: "nonlinear", colour: "nonlinear", points: true },
];

const seconds = (iso) => Date.parse(iso) / 1000;

/** Reads the levels of a node since a recorded time, oldest first; the newest of them if they are many. */
export async function readHistory(rig, node, since) {
  const from = since ? `&since=${encodeURIComponent(since)}` : "";
  const rows = await all(`${path("rigs", rig)}/history?node=${encodeURIComponent(node)}&limit=1000${from}`, MOST);
  return rows.reverse();
}

/** Reads when the alarms of a node were raised, changed and went: marks for the charts. */
export async function readMarks(rig, node) {
  const query = `rig=${encodeURIComponent(rig)}&node=${encodeURIComponent(node)}&limit=${MARKED}`;
  const { items } = await get(`/alarms?${query}`);
  const journals = await Promise.all(items.map(({ id }) => get(path("alarms", id))));
  const shown = {
    raised: ["alarm", "▲ raised"],
    cleared: ["noise", "▽ cleared"],
    acknowledged: ["muted", "✓ acknowledged"],
  };
  return journals
    .flatMap(({ changes }) => changes)
    .filter(({ event }) => shown[event])
    .map(({ event, time }) => ({ x: seconds(time), colour: shown[event][0], label: shown[event][1] }));
}

/** What a complete baseline says as a level, dB: its started scale, `x = 10 log10(power / s + 1)`, undone. */
export function baselineLevels(baselines) {
  return baselines
    .filter(({ complete, mean_db }) => complete && mean_db !== null)
    .map(({ mean_db: mean, deviation_db: spread, reference_noise_db: noise }) => {
      const level = (x) => noise + 10 * Math.log10(Math.max(10 ** (x / 10) - 1, 1e-3));
      return { y: level(mean - 2 * (spread ?? 0)), to: level(mean + 2 * (spread ?? 0)), colour: "nonlinear" };
    });
}

/** Two charts over time; gives { set({ rows, marks, limit, baselines }), close() }. */
export function levels(host, unit) {
  let shown = { rows: [], marks: [], limit: null, baselines: [] };
  const places = [h("div", { class: "chart" }), h("div", { class: "chart" })];
  const note = h("p", { class: "hint" });
  const drawn = h(
    "div",
    { class: "pair" },
    h(
      "figure",
      {},
      h("figcaption", {}, h("strong", {}, "Total over noise"), ": the dashed line is the alarm's limit"),
      places[0],
    ),
    h("figure", {}, h("figcaption", {}, h("strong", {}, "Levels"), ": a band is the learnt baseline"), places[1]),
  );
  host.replaceChildren(note, drawn);
  const time = { logarithmic: false, write: (value) => clock(new Date(1000 * value).toISOString()) };
  const marks = () => shown.marks;
  const padded = (values) => (u, low, high) => {
    const [from, to] = [Math.min(low ?? 0, ...values()), Math.max(high ?? 1, ...values())];
    return [from - 2, to + 3];
  };
  const lines = () => [shown.limit === null ? [] : { y: shown.limit, colour: "alarm" }].flat();
  const plots = [
    chart(places[0], {
      label: "History of the ratio of total to noise",
      series: RATIOS,
      x: time,
      marks,
      levels: lines,
      height: 240,
      y: { label: "total / noise (dB)", range: padded(() => lines().map(({ y }) => y)) },
      sync: "history",
    }),
    chart(places[1], {
      label: "History of the levels",
      series: LEVELS,
      x: time,
      marks,
      levels: () => baselineLevels(shown.baselines),
      height: 240,
      y: { label: `level (dB re 1 (${unit})²)`, range: padded(() => []) },
      sync: "history",
    }),
  ];
  return {
    set(values) {
      if (Object.entries(values).every(([name, value]) => shown[name] === value)) return;
      shown = { ...shown, ...values };
      const { rows } = shown;
      note.textContent = rows.length ? "" : "No levels yet: the first come with the first complete realisation.";
      drawn.hidden = !rows.length;
      if (!rows.length) return;
      const times = rows.map((row) => seconds(row.time));
      [RATIOS, LEVELS].forEach((series, i) =>
        plots[i].set([times, ...series.map(({ key }) => rows.map((row) => row[key]))]),
      );
    },
    close() {
      plots.forEach((plot) => plot.close());
    },
  };
}
