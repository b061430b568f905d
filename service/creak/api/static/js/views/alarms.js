// The list of alarms, and one alarm with its journal.

import { alarmButtons, diagnosisOf } from "../actions.js";
import { facts, h, replace, section, table } from "../dom.js";
import { clock, decibels, words } from "../format.js";
import { all, get, path } from "../http.js";
import { attempt, calm, hear, live, subscribe } from "../live.js";
import { to } from "../router.js";
import { stateBadge } from "../states.js";

const about = (alarm) =>
  alarm.node && live.rigs.get(alarm.rig)?.nodes.includes(alarm.node)
    ? h(
        "a",
        { href: to("rigs", alarm.rig, "nodes", alarm.node), "data-key": `node of ${alarm.id}` },
        `${alarm.rig} / ${alarm.node}`,
      )
    : [alarm.rig, alarm.node].filter(Boolean).join(" / ");

/** Alarms as a table with what can be done about each. */
export function alarmTable(alarms, empty = "No alarm stands.") {
  return table(
    [
      { head: "State", cell: (alarm) => stateBadge(alarm.state, alarm.severity) },
      { head: "Rig / node", cell: about },
      {
        head: "Since",
        cell: (alarm) =>
          h(
            "a",
            {
              href: to("alarms", alarm.id),
              title: `recorded time ${alarm.since}`,
              "data-key": `alarm ${alarm.id}`,
            },
            clock(alarm.since),
          ),
      },
      {
        head: "Total / noise",
        cell: (alarm) => decibels(alarm.level_db, "dB"),
        number: true,
        hint: "when it last changed",
      },
      {
        head: "What",
        cell: (alarm) =>
          `${alarm.class === "quality" ? "data: " : ""}${words(alarm.condition).replaceAll("+", ", ")}`,
      },
      { head: "Actions", quiet: true, cell: alarmButtons },
    ],
    alarms,
    {
      stacked: true,
      caption: "Alarms",
      empty,
      mark: (alarm) => (alarm.active ? `active ${alarm.severity}` : null),
    },
  );
}

export function alarms(root) {
  let everything = null; // null: only those that stand
  const choice = h(
    "select",
    { "aria-label": "Which alarms" },
    h("option", { value: "standing" }, "that stand"),
    h("option", { value: "all" }, "of all time, the newest 200"),
  );
  const list = h("div", { class: "card" });
  root.append(h("div", { class: "title" }, h("h1", { tabindex: "-1" }, "Alarms"), choice), list);

  const show = () => live.loaded && replace(list, alarmTable(everything ?? live.alarms));
  const read = calm(async () => {
    everything = choice.value === "all" ? await all("/alarms?limit=200", 200) : null;
    show();
  });
  choice.addEventListener("change", () => attempt(read));
  const ends = [subscribe(show), hear((kind) => kind === "alarm" && everything && read())];
  show();
  return { close: () => ends.forEach((end) => end()) };
}

export async function alarm(root, { id }) {
  const place = h("div", { class: "view" });
  root.append(place);

  const read = calm(async () => {
    const [found, diagnosis] = await Promise.all([get(path("alarms", id)), diagnosisOf(id)]);
    replace(
      place,
      h("p", { class: "crumbs" }, h("a", { href: to("alarms") }, "Alarms")),
      h(
        "div",
        { class: "title" },
        h(
          "h1",
          { tabindex: "-1", "data-key": "title" },
          `Alarm: ${[found.rig, found.node].filter(Boolean).join(", node ")}`,
        ),
        stateBadge(found.state, found.severity),
      ),
      h(
        "section",
        { class: "card" },
        h("p", {}, found.guidance),
        facts([
          ["what", words(found.condition)],
          ["severity", found.severity],
          ["about", found.class],
          ["raised", clock(found.since)],
          ["total / noise", decibels(found.level_db, "dB")],
          ["shelved until", found.shelved_until && clock(found.shelved_until)],
          ["where", about(found)],
          [
            "diagnosis",
            diagnosis &&
              h(
                "a",
                { href: to("diagnoses", diagnosis.id), "data-key": "diagnosis" },
                `${words(diagnosis.status)}, ${clock(diagnosis.created_at)}`,
              ),
          ],
        ]),
        alarmButtons(found),
      ),
      section(
        "Journal",
        table(
          [
            {
              head: "When",
              cell: (change) => h("span", { title: `recorded time ${change.time}` }, clock(change.time)),
            },
            { head: "What", cell: (change) => words(change.event) },
            { head: "State", cell: (change) => stateBadge(change.state, change.severity) },
            { head: "Total / noise", cell: (change) => decibels(change.level_db, "dB"), number: true },
            { head: "Who", cell: (change) => change.by || "creak" },
            { head: "Comment", cell: (change) => h("span", { class: "comment" }, change.comment) },
          ],
          found.changes,
          { caption: "Journal of the alarm" },
        ),
      ),
    );
  });
  await read();
  return { close: hear((kind, data) => kind === "alarm" && data.id === id && read()) };
}
