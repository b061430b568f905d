// What an operator does about an alarm: acknowledge, shelve, take back, diagnose.

import { question, toast } from "./dialogs.js";
import { h } from "./dom.js";
import { clock } from "./format.js";
import { get, now, path, post, request } from "./http.js";
import { live, refreshAlarms } from "./live.js";
import { to } from "./router.js";

const NAME = "creak-operator";
const SHELVINGS = [
  ["3600", "1 hour"],
  ["14400", "4 hours"],
  ["28800", "8 hours"],
  ["86400", "24 hours"],
];

const who = () => ({
  name: "by",
  label: "Your name",
  required: true,
  value: localStorage.getItem(NAME) ?? "",
  autocomplete: "name",
});
const comment = { name: "comment", label: "Comment", multiline: true };

/** Asks and does it; the alarm must not have changed since it was read, or nothing happens. */
async function act(alarm, verb, { title, action, fields = [], body = () => ({}), said }) {
  const seen = await request(path("alarms", alarm.id));
  const tag = seen.headers.get("ETag");
  const standing = await seen.json();
  const kind = standing.severity === "warning" ? "Warning" : "Alarm";
  const level = standing.level_db === null ? "" : `, ${standing.level_db.toFixed(1)} dB`;
  const done = await question({
    title: `${title}: ${alarm.rig}, node ${alarm.node}`,
    text: `${kind} since ${clock(standing.since)}${level}. ${standing.guidance}`,
    fields: [who(), ...fields, comment],
    action,
    async send(values) {
      localStorage.setItem(NAME, values.by);
      const asked = { by: values.by, comment: values.comment, ...body(values) };
      const headers = { "If-Match": tag };
      return request(`${path("alarms", alarm.id)}/${verb}`, { method: "POST", body: asked, headers });
    },
  });
  if (!done) return;
  const noted = done.status === 202; // the worker of the rig does not answer at present
  toast(`Alarm of ${alarm.rig}, node ${alarm.node}: ${noted ? `to be ${said} once its rig answers` : said}.`);
  await refreshAlarms();
}

const acknowledge = (alarm) =>
  act(alarm, "acknowledge", { title: "Acknowledge", action: "Acknowledge", said: "acknowledged" });

const shelve = (alarm) =>
  act(alarm, "shelve", {
    title: "Shelve",
    action: "Shelve",
    said: "shelved",
    fields: [
      {
        name: "span",
        label: "For",
        options: SHELVINGS,
        value: "28800",
        required: true,
        hint: "of the rig's recorded time",
      },
    ],
    body({ span }) {
      const last = live.rigs.get(alarm.rig)?.last; // shelvings end in recorded time
      const from = last ? Date.parse(last) : now();
      return { until: new Date(from + Number(span) * 1000).toISOString() };
    },
  });

const unshelve = (alarm) =>
  act(alarm, "unshelve", { title: "End the shelving", action: "Unshelve", said: "unshelved" });

/** Has the gap between recording and model explained, and shows how that goes. */
async function diagnose(alarm) {
  const job = await post("/diagnoses", { alarm: alarm.id });
  location.hash = to("diagnoses", job.id);
}

const reported = (task) => async (event) => {
  const button = event.currentTarget;
  button.disabled = true;
  try {
    await task();
  } catch (error) {
    toast(error.message);
  } finally {
    button.disabled = false;
  }
};

/** The buttons for what can be done about an alarm as it stands. */
export function alarmButtons(alarm) {
  const about = ` alarm of ${alarm.rig}, node ${alarm.node}`;
  const button = (verb, task, kind) =>
    h(
      "button",
      {
        type: "button",
        class: kind,
        "data-key": `${verb} ${alarm.id}`,
        onclick: reported(() => task(alarm)),
      },
      verb,
      h("span", { class: "hidden" }, about),
    );
  const over = alarm.state === "normal";
  const waiting = ["unacknowledged", "returned_unacknowledged"].includes(alarm.state);
  return h(
    "div",
    { class: "buttons" },
    waiting && button("Acknowledge", acknowledge, "primary"),
    !over && !alarm.shelved && button("Shelve", shelve),
    alarm.shelved && button("Unshelve", unshelve),
    alarm.class === "process" && button("Diagnose", diagnose),
  );
}

/** A button that does something which may fail, and says so then. */
export const actionButton = (text, task, { key = text, kind = null, label = null } = {}) =>
  h(
    "button",
    { type: "button", class: kind, "data-key": key, "aria-label": label, onclick: reported(task) },
    text,
  );

/** The newest diagnosis that was asked for because of an alarm; null if there is none. */
export async function diagnosisOf(alarm) {
  const { items } = await get("/diagnoses?limit=100");
  return items.find((job) => job.request.alarm === alarm) ?? null;
}
