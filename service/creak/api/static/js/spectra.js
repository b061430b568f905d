// A node's spectra as in the paper's figure 9, classical and networked side by side.

import { chart } from "./charts.js";
import { h, replace, table } from "./dom.js";
import { hertz, probability } from "./format.js";

const SERIES = [
  { key: "signal", label: "signal", colour: "signal", width: 1 },
  { key: "total", label: "total", colour: "total", width: 1.5 },
  { key: "noise", label: "noise", colour: "noise", width: 1.5, dash: [6, 3] },
  { key: "nonlinear", label: "nonlinear", colour: "nonlinear", points: true },
];
const KINDS = [
  ["classical_", "Classical", "distortion of the whole structure is seen at every node"],
  ["", "Networked", "only what acts at this node is seen"],
];

/** Two charts and the table of octaves; gives { set(spectrum), close() }. */
export function spectra(host, unit) {
  let range = [-140, 0];
  const charts = KINDS.map(([, name, says]) => {
    const place = h("div", { class: "chart" });
    const drawn = h("figure", {}, h("figcaption", {}, h("strong", {}, name), `: ${says}`), place);
    return { place, drawn };
  });
  const octaves = h("details", {}, h("summary", {}, "As a table, by octave"), h("div"));
  host.replaceChildren(
    h(
      "div",
      { class: "pair" },
      charts.map(({ drawn }) => drawn),
    ),
    octaves,
  );
  const plots = charts.map(({ place }, i) =>
    chart(place, {
      label: `${KINDS[i][1]} spectra, level over frequency. Arrow keys read values; a table of octaves follows.`,
      series: SERIES,
      x: { label: "frequency (Hz)", logarithmic: true, write: hertz },
      y: { label: `level (dB re 1 (${unit})²)`, range: () => range },
      sync: "spectra",
    }),
  );
  return {
    set(spectrum) {
      const columns = KINDS.map(([prefix]) =>
        SERIES.map(({ key }) => spectrum[key === "signal" ? "signal_db" : `${prefix}${key}_db`]),
      );
      range = bounds(columns.flat());
      plots.forEach((plot, i) => plot.set([spectrum.frequency_hz, ...columns[i]]));
      replace(
        octaves.lastChild,
        table(
          [
            { head: "from", cell: (band) => hertz(band.from_hz), number: true },
            { head: "to", cell: (band) => hertz(band.to_hz), number: true },
            { head: "lines", cell: (band) => band.lines, number: true },
            { head: "p, networked", cell: (band) => probability(band.p_value), number: true },
            { head: "p, classical", cell: (band) => probability(band.classical_p_value), number: true },
          ],
          spectrum.bands,
          { caption: "Probability of such levels if the structure is linear, by octave" },
        ),
      );
    },
    close() {
      plots.forEach((plot) => plot.close());
    },
  };
}

/** The range of both charts; nonlinear levels far below the noise are estimates of nothing and may fall out. */
function bounds(columns) {
  const measured = columns
    .filter((_, i) => SERIES[i % SERIES.length].key !== "nonlinear")
    .flat()
    .filter((value) => value !== null);
  if (!measured.length) return [-140, 0];
  const [low, high] = measured.reduce(
    ([least, most], value) => [Math.min(least, value), Math.max(most, value)],
    [Infinity, -Infinity],
  );
  return [10 * Math.floor(low / 10), 10 * Math.ceil((high + 2) / 10)];
}
