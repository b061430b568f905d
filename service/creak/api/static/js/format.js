// How figures, times and sizes are written.

const MINUS = "−";

/** Decibels with one decimal; a dash where there is no figure. */
export function decibels(value, unit = "") {
  if (value === null || value === undefined) return "–";
  const text = value.toFixed(1).replace("-", MINUS);
  return unit ? `${text} ${unit}` : text;
}

/** A probability: small ones as a power, as only their order counts. */
export function probability(value) {
  if (value === null || value === undefined) return "–";
  if (value < 1e-15) return "< 1e−15";
  return value < 0.001 ? value.toExponential(0).replace("-", MINUS) : value.toFixed(3);
}

export function percent(value) {
  if (value === null || value === undefined) return "–";
  return value > 0.985 && value < 0.9995 ? `${(100 * value).toFixed(1)} %` : `${Math.round(100 * value)} %`;
}

/** A number with four significant digits. */
export function figure(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  const text =
    size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(3) : String(Number(value.toPrecision(4)));
  return text.replaceAll("-", MINUS).replace("e+", "e");
}

export function hertz(value) {
  return `${Number(value.toPrecision(4))} Hz`;
}

export function bytes(size) {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let power = 0;
  while (size >= 1000 && power < units.length - 1) {
    size /= 1000;
    power += 1;
  }
  return `${power ? size.toPrecision(3) : size} ${units[power]}`;
}

/** Seconds as the largest two units say it. */
export function duration(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  const parts = [
    ["d", 86400],
    ["h", 3600],
    ["min", 60],
    ["s", 1],
  ].map(([unit, size], i, all) => [unit, Math.floor((i ? whole % all[i - 1][1] : whole) / size)]);
  const first = parts.findIndex(([, count]) => count);
  if (first < 0) return "0 s";
  return parts
    .slice(first, first + 2)
    .filter(([, count]) => count)
    .map(([unit, count]) => `${count} ${unit}`)
    .join(" ");
}

/** An ISO time on this machine's clock: the time of day, with the date where that is not today. */
export function clock(iso) {
  if (!iso) return "–";
  const time = new Date(iso);
  const two = (value) => String(value).padStart(2, "0");
  const day = `${time.getFullYear()}-${two(time.getMonth() + 1)}-${two(time.getDate())}`;
  const hour = `${two(time.getHours())}:${two(time.getMinutes())}:${two(time.getSeconds())}`;
  return time.toDateString() === new Date().toDateString() ? hour : `${day} ${hour}`;
}

/** A count with its noun. */
export function count(number, noun, plural = `${noun}s`) {
  return `${number} ${number === 1 ? noun : plural}`;
}

/** Where something acts: between two nodes, a node and the ground, or at one node. */
export function place(at) {
  return at.length > 1 ? `${at[0]} – ${at[1]}` : at[0];
}

export const words = (name) => name.replaceAll("_", " ");
