// One node: its spectra live, classical and networked side by side, and the history of its levels.

import { MOST, levels, readHistory, readMarks } from "../levels.js";
import { spectra } from "../spectra.js";
import { alarmButtons } from "../actions.js";
import { facts, h, replace } from "../dom.js";
import { clock, count, decibels, figure, probability } from "../format.js";
import { all, get, path } from "../http.js";
import { alarmOf, attempt, calm, hear, live, subscribe } from "../live.js";
import { to } from "../router.js";
import { stateBadge } from "../states.js";

const SPANS = [
  ["3600", "the last hour"],
  ["86400", "the last day"],
  ["604800", "the last week"],
  ["", "as far as it is kept"],
];

const NONE = "No baseline is learnt for this node ([rigs.baseline] in the service file).";

export async function node(root, { rig, node: name }) {
  const base = path("rigs", rig, "nodes", name);
  let now = await get(base);
  const [head, figures, chartHost, historyHost, learnt] = Array.from({ length: 5 }, () => h("div"));
  const caption = h("p", { class: "hint" });
  const scope = h(
    "select",
    { "aria-label": "Realisations of the spectra" },
    h("option", { value: "window" }, "live window"),
    h("option", { value: "run" }, "whole run"),
  );
  const span = h(
    "select",
    { "aria-label": "Span of the history" },
    SPANS.map(([value, text]) => h("option", { value }, text)),
  );
  span.value = "86400";
  root.append(
    h("p", { class: "crumbs" }, h("a", { href: "#/" }, "Fleet"), " / ", h("a", { href: to("rigs", rig) }, rig)),
    head,
    h("section", { class: "card" }, figures),
    h(
      "section",
      { class: "card" },
      h("div", { class: "title" }, h("h2", {}, "Spectra"), scope),
      caption,
      chartHost,
    ),
    h(
      "section",
      { class: "card" },
      h("div", { class: "title" }, h("h2", {}, "History"), span),
      historyHost,
      learnt,
    ),
  );
  const drawn = spectra(chartHost, now.output);
  const past = levels(historyHost, now.output);
  let rows = [];

  function show() {
    now = { ...now, ...live.nodes.get(rig)?.find((each) => each.name === name) };
    const alarm = alarmOf(rig, name);
    replace(
      head,
      h(
        "div",
        { class: "title" },
        h("h1", { tabindex: "-1", "data-key": "title" }, `${rig}, node ${name}`),
        stateBadge(now.alarm, alarm?.severity),
        alarm && alarmButtons(alarm),
        alarm && h("a", { href: to("alarms", alarm.id), "data-key": "alarm" }, `alarm of ${clock(alarm.since)}`),
      ),
    );
    const { odd_db: odd, even_db: even } = now.detection ?? {};
    replace(
      figures,
      facts([
        ["total / noise", h("strong", {}, decibels(now.total_to_noise_db, "dB"))],
        ["classical", decibels(now.classical_total_to_noise_db, "dB")],
        ["p", probability(now.p_value)],
        ["signal", decibels(now.signal_db, "dB")],
        ["noise", decibels(now.noise_db, "dB")],
        ["total", decibels(now.total_db, "dB")],
        ["nonlinear", decibels(now.nonlinear_db, "dB")],
        ["odd lines", odd !== undefined && odd !== null ? decibels(odd, "dB") : null],
        ["even lines", even !== undefined && even !== null ? decibels(even, "dB") : null],
        ["input", now.input ?? "not driven"],
        ["output", now.output],
        ["recorded", clock(now.time)],
      ]),
    );
    past.set({ limit: live.details.get(rig)?.limits.total_to_noise_db ?? null });
  }

  const readSpectrum = calm(async () => {
    chartHost.hidden = now.time === null;
    if (now.time === null) {
      caption.textContent = "No spectrum yet: the first comes with the first complete realisation.";
    } else {
      const spectrum = await get(`${base}/spectrum?scope=${scope.value}`);
      const found = spectrum.significant.filter(Boolean).length;
      caption.textContent = [
        `${count(spectrum.realisations, "realisation")}, recorded until ${clock(spectrum.time)}`,
        `${count(found, "line")} of ${spectrum.frequency_hz.length} beyond noise`,
        `false discovery rate ${figure(spectrum.false_discovery_rate)}`,
      ].join("; ");
      drawn.set(spectrum);
    }
  });

  const readPast = calm(async () => {
    const last = live.rigs.get(rig)?.last;
    const from = span.value && last ? new Date(Date.parse(last) - 1000 * Number(span.value)).toISOString() : null;
    rows = await readHistory(rig, name, from);
    past.set({ rows });
  });

  const readMarksAndBaselines = calm(async () => {
    const [marks, baselines] = await Promise.all([
      readMarks(rig, name),
      all(`${path("rigs", rig)}/baselines?node=${encodeURIComponent(name)}`),
    ]);
    past.set({ marks, baselines });
    replace(
      learnt,
      baselines.length ? h("ul", { class: "hint" }, baselines.map(baseline)) : h("p", { class: "hint" }, NONE),
    );
  });

  const extend = calm(async () => {
    const newer = await readHistory(rig, name, rows.at(-1)?.time);
    const known = new Set(rows.map(({ time }) => time));
    rows = [...rows, ...newer.filter(({ time }) => !known.has(time))].slice(-MOST);
    past.set({ rows });
  });

  scope.addEventListener("change", () => attempt(readSpectrum));
  span.addEventListener("change", () => attempt(readPast));
  show();
  const ends = [
    subscribe(show),
    hear((kind, event) => {
      if (event.rig !== rig) return null;
      show();
      return Promise.all([
        kind === "levels" && event.scope === scope.value && readSpectrum(),
        kind === "levels" && event.scope === "window" && extend(),
        kind === "alarm" && event.node === name && readMarksAndBaselines(),
      ]);
    }),
    () => drawn.close(),
    () => past.close(),
  ];
  const close = () => ends.forEach((end) => end());
  try {
    await Promise.all([readSpectrum(), readPast(), readMarksAndBaselines()]);
  } catch (error) {
    close();
    throw error;
  }
  return { close };
}

function baseline({ state_rms: rms, complete, realisations }) {
  const state = complete ? "complete" : "being learnt";
  return h(
    "li",
    {},
    `Baseline at an excitation of ${figure(rms)} rms: ${state}, ${count(realisations, "realisation")}.`,
  );
}
