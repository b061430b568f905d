// Recordings: to be downloaded, replayed, diagnosed.

import { actionButton } from "../actions.js";
import { h, replace, section, table } from "../dom.js";
import { bytes, clock } from "../format.js";
import { all, download, path, post } from "../http.js";
import { hear } from "../live.js";
import { to } from "../router.js";
import { statusBadge } from "../states.js";
import { jobTable, readJobs } from "./jobs.js";

const POLL_MS = 5000;

export async function recordings(root) {
  const [list, replays] = [h("div"), h("div")];
  root.append(
    h("div", { class: "title" }, h("h1", { tabindex: "-1" }, "Recordings")),
    h("div", { class: "card" }, list),
    section("Replays", replays),
  );

  async function read() {
    const [found, jobs] = await Promise.all([all("/recordings?limit=200", 1000), readJobs("/jobs?limit=50")]);
    replace(
      list,
      table(
        [
          { head: "Rig", cell: ({ rig }) => rig },
          { head: "From", cell: ({ start }) => clock(start) },
          { head: "To", cell: ({ end }) => (end ? clock(end) : "now") },
          { head: "State", cell: ({ status }) => statusBadge(status) },
          { head: "Size", cell: ({ size }) => bytes(size), number: true },
          { head: "File", cell: ({ path: file }) => h("span", { class: "file", title: file }, fileName(file)) },
          {
            head: "Actions",
            quiet: true,
            cell: (recording) =>
              h(
                "div",
                { class: "buttons" },
                button("Download", recording, () =>
                  download(`${path("recordings", recording.id)}/file`, fileName(recording.path)),
                ),
                button("Replay", recording, () =>
                  begin(`${path("recordings", recording.id)}/replay`, undefined, "jobs"),
                ),
                button("Diagnose", recording, () => begin("/diagnoses", { recording: recording.id }, "diagnoses")),
              ),
          },
        ],
        found,
        { stacked: true, caption: "Recordings", empty: "Nothing has been recorded yet." },
      ),
    );
    replace(
      replays,
      jobTable(
        jobs.filter(({ kind }) => kind === "replay"),
        "No recording has been replayed from here.",
      ),
    );
  }
  await read();
  const timer = setInterval(() => read().catch(() => {}), POLL_MS); // that it cannot be read is said above
  const end = hear((kind) => kind === "run" && read());
  return {
    close() {
      clearInterval(timer);
      end();
    },
  };
}

const fileName = (file) => file.split(/[\\/]/).pop();

const button = (text, { id }, task) => actionButton(text, task, { key: `${text} ${id}`, label: `${text} ${id}` });

async function begin(where, body, view) {
  const job = await post(where, body);
  location.hash = to(view, job.id);
}
