// What is known of the fleet at present: read once, kept up by the event stream, and told to whoever shows it.

import { Unreachable, all, get, now, path } from "./http.js";
import { rank } from "./states.js";
import { listen } from "./stream.js";

const PAUSE_MS = 300; // between two readings of the same in a storm of events
const POLL_MS = 5000; // frames make no events, so how far a rig has come is asked for
const SILENT_S = 60; // as for /readyz: a minute, or five periods of a slow rig
const SILENT_PERIODS = 5;
const STANDING = [
  "unacknowledged",
  "acknowledged",
  "returned_unacknowledged",
  "shelved",
  "suppressed",
  "out_of_service",
];

export const live = {
  loaded: false,
  connected: false,
  since: null, // ms; when the connection was lost
  problem: null, // why the figures are not up to date
  rigs: new Map(), // by name: the summary
  nodes: new Map(), // by rig: its nodes with their levels
  details: new Map(), // by rig: all that is known of its run
  pictures: new Map(), // by rig: its structure and the elements that distort
  alarms: [], // that stand, the most urgent first
};

const listeners = new Set();
const hearers = new Set();
let told = false;
let streaming = false; // whether the event stream is open

/** Calls a function when anything changed, at most once a frame; returns what ends that. */
export function subscribe(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

/** Calls a function with every event (kind, data); returns what ends that. */
export function hear(hearer) {
  hearers.add(hearer);
  return () => hearers.delete(hearer);
}

function tell() {
  if (told) return;
  told = true;
  setTimeout(() => {
    told = false;
    for (const listener of [...listeners]) listener();
  }, 30);
}

/** Does what may fail; that it did is said at the top of the page. */
export async function attempt(task) {
  try {
    await task();
  } catch (error) {
    live.problem = error;
    tell();
  }
}

/** Does a task once at a time, and once more for all who asked meanwhile: a storm of events is met calmly. */
export function calm(task) {
  let running = null;
  let again = false;
  return () => {
    again = true;
    running ??= (async () => {
      while (again) {
        again = false;
        await task();
        if (again) await new Promise((done) => setTimeout(done, PAUSE_MS));
      }
    })().finally(() => {
      running = null;
    });
    return running;
  };
}

/** The same for what keeps the figures up to date: whether it could is said at the top of the page. */
function refreshing(task) {
  const calmly = calm(task);
  return async () => {
    try {
      await calmly();
      live.problem = null;
      if (streaming) found(); // a single request had failed, and the stream has not
    } catch (error) {
      live.problem = error;
      if (error instanceof Unreachable) lost();
    }
    tell();
  };
}

export const refreshRigs = refreshing(async () => {
  const rigs = await all("/rigs");
  for (const rig of rigs) {
    const known = live.rigs.get(rig.name);
    if (!known || known.run !== rig.run) refreshRig(rig.name);
  }
  live.rigs = new Map(rigs.map((rig) => [rig.name, rig]));
  live.loaded = true;
});

export const refreshAlarms = refreshing(async () => {
  const alarms = await all(`/alarms?${STANDING.map((state) => `state=${state}`).join("&")}&limit=500`);
  live.alarms = alarms.sort(
    (one, other) => rank(other.state) - rank(one.state) || (one.since < other.since ? 1 : -1),
  );
});

/** A task for any rig, of which each has its own. */
function ofRig(wrap, task) {
  const tasks = new Map();
  return (name) => {
    if (!tasks.has(name))
      tasks.set(
        name,
        wrap(() => task(name)),
      );
    return tasks.get(name)();
  };
}

const refreshRig = ofRig(refreshing, async (name) => {
  const base = path("rigs", name);
  const [detail, nodes] = await Promise.all([get(base), all(`${base}/nodes?limit=1000`)]);
  live.details.set(name, detail);
  live.nodes.set(name, nodes);
});

/** Reads what is needed to draw a rig, for the views that draw it. */
export const readPicture = ofRig(calm, async (name) => {
  const base = path("rigs", name);
  const known = live.pictures.get(name);
  const run = live.rigs.get(name)?.run;
  const [structure, elements] = await Promise.all([
    known && known.run === run ? known.structure : get(`${base}/structure`),
    get(`${base}/elements?limit=50`),
  ]);
  live.pictures.set(name, { run, structure, elements });
  tell();
});

/** True for events after which a rig is to be drawn anew. */
export const changesPicture = (kind, { scope }) => kind === "run" || (kind === "levels" && scope === "window");

export function refreshAll() {
  return Promise.all([refreshRigs(), refreshAlarms(), ...[...live.rigs.keys()].map(refreshRig)]);
}

const HEARD = {
  levels({ rig, scope, time, nodes }) {
    if (scope !== "window") return;
    const known = live.nodes.get(rig);
    if (!known) return;
    const levels = new Map(nodes.map((node) => [node.name, node]));
    live.nodes.set(
      rig,
      known.map((node) => ({ ...node, ...levels.get(node.name), time })),
    );
  },
  alarm({ rig }) {
    refreshAlarms();
    refreshRigs();
    if (live.rigs.has(rig)) refreshRig(rig);
  },
  run: refreshRigs,
  fault: ({ rig }) => refreshRig(rig),
  reset: refreshAll,
};

function found() {
  live.connected = true;
  live.since = null;
}

function lost() {
  if (live.connected || live.since === null) live.since = Date.now();
  live.connected = false;
  tell();
}

/** Begins to listen and to ask; never ends. */
export function start() {
  listen({
    open(resumed) {
      streaming = true;
      found();
      if (!resumed) refreshAll();
      else tell();
    },
    event(kind, data) {
      HEARD[kind]?.(data);
      for (const hearer of [...hearers]) attempt(() => hearer(kind, data));
      tell();
    },
    closed() {
      streaming = false;
      lost();
    },
  });
  setInterval(() => {
    if (live.loaded && !document.hidden) refreshRigs();
  }, POLL_MS);
  setInterval(tell, 1000); // ages grow
}

/** How a rig fares: its status, or that it is silent; for how long it has not been heard of, s. */
export function condition(rig) {
  const heard = rig.heard_at ? (now() - Date.parse(rig.heard_at)) / 1000 : null;
  if (rig.status !== "running") return { status: rig.status, silence: heard };
  const detail = live.details.get(rig.name);
  const period = detail ? detail.period_samples / detail.sample_rate : 0;
  const silent = heard !== null && heard > Math.max(SILENT_S, SILENT_PERIODS * period);
  return { status: silent ? "silent" : "running", silence: heard };
}

/** True if what is shown may be out of date. */
export const stale = () => live.loaded && !live.connected;

/** The most urgent alarm of a node, if any stands; those about data come after. */
export function alarmOf(rig, node) {
  const standing = live.alarms.filter((alarm) => alarm.rig === rig && alarm.node === node);
  return standing.find((alarm) => alarm.class === "process") ?? standing[0];
}
