// What is known of the fleet at present: read once, kept up by the event stream, and told to whoever shows it.

import { Unreachable, all, get, now, path } from "./http.js";
import { rank } from "./states.js";
import { listen } from "./stream.js";

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

/** One run of a task at a time; what asks for it meanwhile gets one more. */
function single(task) {
  let running = null;
  let again = false;
  return () => {
    if (running) {
      again = true;
      return running;
    }
    running = (async () => {
      do {
        again = false;
        await task();
      } while (again);
    })()
      .then(
        () => {
          live.problem = null;
        },
        (error) => {
          live.problem = error;
          if (error instanceof Unreachable) lost();
        },
      )
      .finally(() => {
        running = null;
        tell();
      });
    return running;
  };
}

export const refreshRigs = single(async () => {
  const rigs = await all("/rigs");
  for (const rig of rigs) {
    const known = live.rigs.get(rig.name);
    if (!known || known.run !== rig.run) refreshRig(rig.name);
  }
  live.rigs = new Map(rigs.map((rig) => [rig.name, rig]));
  live.loaded = true;
});

export const refreshAlarms = single(async () => {
  const alarms = await all(`/alarms?${STANDING.map((state) => `state=${state}`).join("&")}&limit=500`);
  live.alarms = alarms.sort(
    (one, other) => rank(other.state) - rank(one.state) || (one.since < other.since ? 1 : -1),
  );
});

async function refreshRig(name) {
  const base = path("rigs", name);
  try {
    const [detail, nodes] = await Promise.all([get(base), all(`${base}/nodes?limit=1000`)]);
    live.details.set(name, detail);
    live.nodes.set(name, nodes);
    tell();
  } catch (error) {
    live.problem = error;
  }
}

/** Reads what is needed to draw a rig, for the views that draw it. */
export async function readPicture(name) {
  const base = path("rigs", name);
  const [structure, elements] = await Promise.all([
    live.pictures.get(name)?.structure ?? get(`${base}/structure`),
    get(`${base}/elements?limit=50`),
  ]);
  live.pictures.set(name, { structure, elements });
  tell();
}

export const changesPicture = (kind, { scope }) => kind === "levels" && scope === "window";

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

function lost() {
  if (live.connected || live.since === null) live.since = Date.now();
  live.connected = false;
  tell();
}

/** Begins to listen and to ask; never ends. */
export function start() {
  listen({
    open(resumed) {
      live.connected = true;
      live.since = null;
      if (!resumed) refreshAll();
      else tell();
    },
    event(kind, data) {
      HEARD[kind]?.(data);
      for (const hearer of [...hearers]) attempt(() => hearer(kind, data));
      tell();
    },
    closed: lost,
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

/** The most urgent alarm of a node, if any stands. */
export const alarmOf = (rig, node) => live.alarms.find((alarm) => alarm.rig === rig && alarm.node === node);
