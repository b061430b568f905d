// Charts drawn by uPlot, with what it lacks: a legend for keyboards, arrow keys, marks, colours of the theme.

import { h, svg } from "./dom.js";
import { colour, onTheme } from "./theme.js";

const HEIGHT = 300;
const FONT = "12px system-ui, sans-serif";

/**
 * Draws a chart; gives { set(data), close() }.
 *
 * series: { label, colour, dash, width, points } each; x: { label, logarithmic, write(value) };
 * y: { label, range }; marks(): vertical lines { x, colour, label }; levels(): horizontal ones { y, to, colour }.
 */
export function chart(
  host,
  { label, series, x, y, marks = () => [], levels = () => [], sync = null, height = HEIGHT },
) {
  const plot = h("div", { class: "plot", tabindex: "0", role: "img", "aria-label": label });
  const legend = h("div", { class: "legend" });
  const readout = h("output", { class: "readout" });
  host.replaceChildren(plot, h("div", { class: "under" }, legend, readout));
  let u = null;

  const options = {
    width: 400,
    height,
    legend: { show: false },
    cursor: { sync: sync ? { key: sync, scales: ["x", null] } : undefined, y: false, drag: { x: true, y: false } },
    scales: { x: { time: !x.logarithmic, distr: x.logarithmic ? 3 : 1, range: ends }, y: { range: y.range } },
    axes: [
      axis(x.logarithmic ? { label: x.label, values: frequencies, size: 36 } : { values: times }),
      axis({ label: y.label, size: 48 }),
    ],
    series: [{}, ...series.map(line)],
    hooks: { setCursor: [read], drawAxes: [drawLevels], draw: [drawMarks] },
  };

  function read() {
    const at = u?.cursor.idx;
    if (at === null || at === undefined) {
      readout.textContent = "";
      return;
    }
    const values = series.flatMap(({ label: name }, i) =>
      u.series[i + 1].show && u.data[i + 1][at] !== null ? [`${name} ${u.data[i + 1][at].toFixed(1)}`] : [],
    );
    readout.textContent = `${x.write(u.data[0][at])}: ${values.join(", ")} dB`;
  }

  function drawLevels() {
    for (const { y: value, to, colour: name } of levels()) {
      const top = u.valToPos(to ?? value, "y", true);
      const size = Math.max(u.valToPos(value, "y", true) - top, 0);
      u.ctx.save();
      u.ctx.beginPath();
      u.ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height);
      u.ctx.clip();
      u.ctx.globalAlpha = size > 2 ? 0.18 : 1;
      u.ctx.fillStyle = u.ctx.strokeStyle = colour(name);
      if (size > 2) u.ctx.fillRect(u.bbox.left, top, u.bbox.width, size);
      else stroke(u, [u.bbox.left, top, u.bbox.left + u.bbox.width, top], [6, 4]);
      u.ctx.restore();
    }
  }

  function drawMarks() {
    for (const [i, { x: value, colour: name, label: text }] of marks().entries()) {
      const left = u.valToPos(value, "x", true);
      if (left < u.bbox.left || left > u.bbox.left + u.bbox.width) continue;
      u.ctx.save();
      u.ctx.strokeStyle = u.ctx.fillStyle = colour(name);
      stroke(u, [left, u.bbox.top, left, u.bbox.top + u.bbox.height], [2, 3]);
      u.ctx.font = `600 ${12 * devicePixelRatio}px system-ui, sans-serif`;
      u.ctx.textAlign = left > u.bbox.left + 0.8 * u.bbox.width ? "right" : "left";
      u.ctx.fillText(` ${text} `, left, u.bbox.top + (12 + 15 * (i % 3)) * devicePixelRatio); // neighbours overlap
      u.ctx.restore();
    }
  }

  function build(data) {
    u = new globalThis.uPlot({ ...options, width: Math.max(plot.clientWidth, 200) }, data, plot);
    legend.replaceChildren(
      ...series.map((each, i) => entry(each, (shown) => u.setSeries(i + 1, { show: shown }))),
    );
  }

  plot.addEventListener("keydown", (event) => {
    if (u && steer(u, event, x.logarithmic)) event.preventDefault();
  });
  const sized = new ResizeObserver(() => u?.setSize({ width: Math.max(plot.clientWidth, 200), height }));
  sized.observe(plot);
  const ended = onTheme(() => u?.redraw());
  return {
    set(data) {
      if (!u) {
        build(data);
        return;
      }
      const all = !zoomed(u);
      u.setData(data, all);
      if (!all) u.redraw();
    },
    close() {
      ended();
      sized.disconnect();
      u?.destroy();
    },
  };
}

function zoomed(u) {
  const [first, last] = [u.data[0][0], u.data[0].at(-1)];
  return u.scales.x.min > first || u.scales.x.max < last;
}

function line({ label, colour: name, dash, width = 1.5, points = false }) {
  return {
    label,
    dash,
    width,
    stroke: () => colour(name),
    paths: points ? () => null : undefined,
    points: points
      ? { show: true, size: 3.5, width: 0, stroke: () => colour(name), fill: () => colour(name) }
      : {
          show: (u, i) => u.data[i].reduce((found, value) => found + (value !== null), 0) < 60,
          size: 5,
          fill: () => colour(name),
        },
  };
}

function axis(more) {
  const grid = { stroke: () => colour("grid"), width: 1 };
  return { font: FONT, labelFont: FONT, labelSize: 20, stroke: () => colour("muted"), grid, ticks: grid, ...more };
}

/** The ends of what is shown; a single point gets some room. */
function ends(u, low, high) {
  return low === high ? [low - 60, high + 60] : [low, high];
}

/** Times of day, with the date beneath where a day begins. */
function times(u, splits, _axis, _space, step) {
  let day = "";
  return splits.map((value) => {
    const time = new Date(1000 * value);
    const two = (number) => String(number).padStart(2, "0");
    const date = `${time.getFullYear()}-${two(time.getMonth() + 1)}-${two(time.getDate())}`;
    const clock = [time.getHours(), time.getMinutes(), time.getSeconds()].map(two);
    const hour = clock.slice(0, step < 60 ? 3 : 2).join(":");
    const lines = [step < 86400 && hour, date !== day && date].filter(Boolean);
    day = date;
    return lines.join("\n");
  });
}

function frequencies(u, splits) {
  return splits.map((value) => (value === null ? "" : String(Number(value.toPrecision(3)))));
}

function stroke({ ctx }, [x0, y0, x1, y1], dash) {
  ctx.lineWidth = 1.5 * devicePixelRatio;
  ctx.setLineDash(dash.map((length) => length * devicePixelRatio));
  ctx.beginPath();
  ctx.moveTo(x0, y0);
  ctx.lineTo(x1, y1);
  ctx.stroke();
}

/** A button that shows and hides a series, with a sample of its line. */
function entry({ label, colour: name, dash, width = 1.5, points }, show) {
  const sample = svg(
    "svg",
    { viewBox: "0 0 28 10", class: `sample ink-${name}`, "aria-hidden": "true" },
    points
      ? [4, 14, 24].map((x) => svg("circle", { cx: x, cy: 5, r: 2.5 }))
      : svg("path", { d: "M0 5h28", "stroke-width": width + 0.5, "stroke-dasharray": dash?.join(" ") }),
  );
  const button = h("button", { type: "button", "aria-pressed": "true" }, sample, label);
  button.addEventListener("click", () => {
    const shown = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(shown));
    show(shown);
  });
  return button;
}

/** Moves the cursor with the arrow keys, zooms with + and -, shows all with 0; tells whether it did. */
function steer(u, event, logarithmic) {
  const last = u.data[0].length - 1;
  const at = u.cursor.idx ?? 0;
  const steps = { ArrowLeft: -1, ArrowRight: 1, Home: -last, End: last };
  const zooms = { "+": 0.5, "-": 2, 0: Infinity };
  if (event.key in steps) {
    const next = Math.min(last, Math.max(0, at + steps[event.key] * (event.shiftKey ? 10 : 1)));
    u.setCursor({ left: u.valToPos(u.data[0][next], "x"), top: u.over.clientHeight / 2 });
    return true;
  }
  if (!(event.key in zooms)) return false;
  const [into, from] = logarithmic ? [Math.log, Math.exp] : [Number, Number];
  const [low, high] = [into(u.data[0][0]), into(u.data[0][last])];
  const centre = into(u.data[0][at]);
  const half = (zooms[event.key] * (into(u.scales.x.max) - into(u.scales.x.min))) / 2;
  u.setScale("x", { min: from(Math.max(low, centre - half)), max: from(Math.min(high, centre + half)) });
  return true;
}
