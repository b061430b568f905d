// What takes longer than a request: lists of jobs, one job as it goes, what a replay found.

import { actionButton } from "../actions.js";
import { facts, h, replace, table } from "../dom.js";
import { clock, duration } from "../format.js";
import { get, path, post } from "../http.js";
import { to } from "../router.js";
import { jobBadge } from "../states.js";
import { nodeTable } from "./rig.js";

const POLL_MS = 1000;
const READ = 20; // finished diagnoses whose verdict is shown in a list

const open = ({ status }) => status === "queued" || status === "running";

/** Jobs of a list, the newest diagnoses among them with their results. */
export async function readJobs(from) {
  const { items } = await get(from);
  const wanted = items.filter(({ kind, status }) => kind === "diagnosis" && status === "done").slice(0, READ);
  const details = new Map(
    (await Promise.all(wanted.map(({ id }) => get(path("jobs", id))))).map((job) => [job.id, job]),
  );
  return items.map((job) => details.get(job.id) ?? job);
}

export function jobTable(jobs, empty, columns = []) {
  return table(
    [
      {
        head: "Asked for",
        cell: (job) =>
          h(
            "a",
            { href: to(job.kind === "replay" ? "jobs" : "diagnoses", job.id), "data-key": job.id },
            clock(job.created_at),
          ),
      },
      { head: "Rig", cell: (job) => job.request.rig },
      {
        head: "Of",
        cell: (job) =>
          job.request.alarm
            ? h("a", { href: to("alarms", job.request.alarm), "data-key": `alarm of ${job.id}` }, "alarm")
            : job.request.recording,
      },
      {
        head: "State",
        cell: jobBadge,
      },
      ...columns,
    ],
    jobs,
    { caption: "Jobs", empty },
  );
}

/** Shows a job until it has ended, then its result; result(job) makes the elements. */
export async function follow(root, id, { title, back, result }) {
  const place = h("div", { class: "view" });
  root.append(place);
  let timer = null;
  let closed = false;

  async function read() {
    const job = await get(path("jobs", id));
    if (closed) return;
    replace(
      place,
      h("p", { class: "crumbs" }, h("a", { href: to(back[0]) }, back[1])),
      h(
        "div",
        { class: "title" },
        h("h1", { tabindex: "-1", "data-key": "title" }, `${title}: ${job.request.rig}`),
        jobBadge(job),
      ),
      open(job) || job.reason || job.status === "cancelled" ? going(job) : null,
      job.result ? result(job) : null,
    );
    if (open(job)) wait();
  }

  function wait() {
    if (!closed) timer = setTimeout(() => read().catch(wait), POLL_MS); // that it cannot be read is said above
  }
  await read();
  return {
    close() {
      closed = true;
      clearTimeout(timer);
    },
  };
}

function going(job) {
  const begun = job.started_at ?? job.created_at;
  return h(
    "section",
    { class: "card" },
    open(job) && h("progress", { value: job.progress, max: "1", "aria-label": "progress" }),
    h(
      "p",
      { role: "status" },
      open(job) ? job.stage || (job.status === "queued" ? "waits for its turn" : "at work") : job.reason,
    ),
    facts([
      ["asked for", clock(job.created_at)],
      ["took", job.ended_at && duration((Date.parse(job.ended_at) - Date.parse(begun)) / 1000)],
    ]),
    open(job) &&
      h(
        "div",
        { class: "buttons" },
        actionButton("Cancel", () => post(`${path("jobs", job.id)}/cancel`)),
      ),
  );
}

export const job = (root, { id }) =>
  follow(root, id, {
    title: "Replay",
    back: ["recordings", "Recordings"],
    result: ({ result, request }) =>
      h(
        "section",
        { class: "card" },
        facts([
          ["recording", request.recording],
          ["frames", result.frames],
          ["rejected", result.rejected_frames],
          ["realisations", result.realisations],
          ["file", result.truncated ? "was cut off" : "whole"],
        ]),
        nodeTable(request.rig, result.nodes),
      ),
  });
