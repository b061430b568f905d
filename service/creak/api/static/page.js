const LEVELS = [
  ["signal_db", "signal"],
  ["noise_db", "noise"],
  ["total_db", "total"],
  ["nonlinear_db", "nonlinear"],
  ["total_to_noise_db", "total / noise"],
  ["classical_total_to_noise_db", "classical"],
];

async function get(path) {
  const answer = await fetch(path, { headers: { Accept: "application/json" } });
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return answer.json();
}

async function all(path) {
  const items = [];
  let cursor = "";
  do {
    const page = await get(path + cursor);
    items.push(...page.items);
    cursor = page.next && `?cursor=${encodeURIComponent(page.next)}`;
  } while (cursor);
  return items;
}

function element(tag, text, className) {
  const made = document.createElement(tag);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

// columns: [heading, cell of a row, whether it is text]; on: which rows stand out
function table(caption, columns, rows, on) {
  const made = element("table");
  if (caption) made.append(element("caption", caption));
  const head = made.createTHead().insertRow();
  for (const [heading, , text] of columns) {
    const cell = element("th", heading, text && "text");
    cell.scope = "col";
    head.append(cell);
  }
  const body = made.createTBody();
  for (const row of rows) {
    const line = body.insertRow();
    if (on(row)) line.className = "on";
    for (const [, value, text] of columns) line.append(element("td", value(row), text && "text"));
  }
  const frame = element("div", undefined, "table");
  frame.append(made);
  return frame;
}

const decibels = (value) => (value === null ? "–" : value.toFixed(1));
const clock = (time) => time.replace("T", " ").replace(/\.\d+Z$/, "Z");

function rigTable(rig, nodes) {
  const caption = `${rig.name}: ${rig.status}, ${rig.realisations} realisations, ${rig.frames} frames`
    + ` (${rig.rejected_frames} rejected)`;
  return table(caption, [
    ["node", (node) => node.name, true],
    ["alarm", (node) => node.alarm.replaceAll("_", " "), true],
    ...LEVELS.map(([key, heading]) => [`${heading} (dB)`, (node) => decibels(node[key])]),
  ], nodes, (node) => node.alarm !== "normal");
}

function alarmTable(alarms) {
  if (!alarms.length) return element("p", "none");
  return table("", [
    ["rig", (alarm) => alarm.rig, true],
    ["node", (alarm) => alarm.node, true],
    ["state", (alarm) => alarm.state.replaceAll("_", " "), true],
    ["severity", (alarm) => alarm.severity, true],
    ["since (recorded)", (alarm) => clock(alarm.since), true],
    ["total / noise (dB)", (alarm) => decibels(alarm.level_db)],
  ], alarms, (alarm) => alarm.active);
}

async function refresh() {
  const state = document.getElementById("state");
  try {
    const rigs = await all("api/v1/rigs");
    const nodes = await Promise.all(rigs.map((rig) => all(`api/v1/rigs/${encodeURIComponent(rig.name)}/nodes`)));
    const alarms = (await get("api/v1/alarms")).items;
    document.getElementById("rigs").replaceChildren(
      ...(rigs.length ? rigs.map((rig, i) => rigTable(rig, nodes[i])) : [element("p", "none yet")]));
    document.getElementById("alarms").replaceChildren(alarmTable(alarms));
    state.textContent = "up to date";
  } catch (error) {
    state.textContent = `not up to date: ${error.message}`;
  }
}

// one refresh at a time; whatever happens meanwhile asks for one more
let busy = false;
let again = false;
async function soon() {
  again = true;
  if (busy) return;
  busy = true;
  while (again) {
    again = false;
    await refresh();
    await new Promise((done) => setTimeout(done, 250));
  }
  busy = false;
}

const events = new EventSource("api/v1/events");
for (const kind of ["open", "run", "levels", "alarm", "fault", "reset"]) events.addEventListener(kind, soon);
setInterval(soon, 5000);
soon();
