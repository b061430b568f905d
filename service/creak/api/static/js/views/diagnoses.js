// Diagnoses: the verdict, the gap before and after, where and what is missing in the model, the report.

import { actionButton } from "../actions.js";
import { facts, h, section, svg, table } from "../dom.js";
import { decibels, figure, hertz, percent, place, words } from "../format.js";
import { ROOT, download, key, path } from "../http.js";
import { to } from "../router.js";
import { statusBadge } from "../states.js";
import { follow, jobTable, readJobs } from "./jobs.js";

const POLL_MS = 3000;
const SAYS = {
  no_gap: "Model and recording agree within noise.",
  explained: "The model lacks what stands below; with it, the gap falls to the noise.",
  partly_explained: "What stands below closes at least half of the gap above noise, not all of it.",
  unknown: "No effect of the vocabulary explains the gap; where the missing force acts still holds.",
};

export async function diagnoses(root) {
  const list = h("div", { class: "card" });
  root.append(
    h("div", { class: "title" }, h("h1", { tabindex: "-1" }, "Diagnoses")),
    h(
      "p",
      { class: "lead" },
      "Where a recording departs from the rig's model, and why. Begun from an alarm's line, or a recording's.",
    ),
    list,
  );
  async function read() {
    const jobs = await readJobs("/diagnoses?limit=100");
    const gap = (job, which) => decibels(job.result?.gap[which] ?? null, "dB");
    list.replaceChildren(
      jobTable(jobs, "Nothing has been diagnosed yet.", [
        { head: "Verdict", cell: ({ result }) => result && statusBadge(result.verdict) },
        { head: "Cause", cell: ({ result }) => result && (result.causes.map(causeName).join("; ") || "–") },
        { head: "Gap before", cell: (job) => gap(job, "before_db"), number: true },
        { head: "after", cell: (job) => gap(job, "after_db"), number: true },
        { head: "noise", cell: (job) => gap(job, "noise_db"), number: true },
      ]),
    );
    return jobs.some(({ status }) => status === "queued" || status === "running");
  }
  let waiting = await read();
  const timer = setInterval(async () => {
    if (waiting) waiting = await read().catch(() => true);
  }, POLL_MS);
  return { close: () => clearInterval(timer) };
}

export const diagnosis = (root, { id }) =>
  follow(root, id, { title: "Diagnosis", back: ["diagnoses", "Diagnoses"], result });

const causeName = ({ effect, at }) => `${words(effect)}, ${place(at)}`;

function result(job) {
  const {
    verdict,
    gap,
    nodes,
    where,
    causes,
    alternatives,
    linear_corrections: corrections,
    held_out_realisations: held,
  } = job.result;
  const numbers = (cause) =>
    Object.entries(cause.parameters)
      .map(([name, value]) =>
        [words(name), figure(value), cause.standard_errors?.[name] && `± ${figure(cause.standard_errors[name])}`]
          .filter(Boolean)
          .join(" "),
      )
      .join(", ");
  const causeColumns = [
    { head: "Effect", cell: ({ effect }) => words(effect) },
    { head: "At", cell: ({ at }) => place(at) },
    { head: "Parameters (SI)", cell: numbers },
    { head: "Probability", cell: ({ probability }) => percent(probability), number: true },
    { head: "Gap after", cell: ({ gap_after_db: after }) => decibels(after, "dB"), number: true },
  ];
  return [
    h(
      "section",
      { class: `card verdict ${verdict}` },
      h("h2", {}, "Verdict: ", statusBadge(verdict)),
      h("p", {}, SAYS[verdict]),
      facts([
        ["gap before", decibels(gap.before_db, "dB")],
        ["after", decibels(gap.after_db, "dB")],
        ["noise alone", decibels(gap.noise_db, "dB")],
        ["closed", gap.closed === null ? "–" : `${(100 * gap.closed).toFixed(2)} %`],
        ["held out", held && `${held} realisation${held > 1 ? "s" : ""}`],
        ["model", job.request.model],
        [
          "realisations",
          job.request.first_realisation !== null &&
            `${job.request.first_realisation} to ${job.request.last_realisation}`,
        ],
      ]),
      h(
        "div",
        { class: "buttons" },
        report(job),
        job.request.alarm &&
          h("a", { class: "button", href: to("alarms", job.request.alarm), "data-key": "alarm" }, "The alarm"),
      ),
    ),
    causes.length ? section("What the model lacks", table(causeColumns, causes, { caption: "Causes" })) : null,
    corrections.length
      ? section(
          "What had to move in the model",
          table(
            [
              {
                head: "Element",
                cell: ({ element }) => (Array.isArray(element) ? place(element) : String(element)),
              },
              { head: "Parameter", cell: ({ parameter }) => words(parameter) },
              { head: "From", cell: ({ from }) => figure(from), number: true },
              { head: "To", cell: (each) => figure(each.to), number: true },
            ],
            corrections,
            { caption: "Linear corrections" },
          ),
        )
      : null,
    section(
      "Before and after",
      table(
        [
          { head: "Node", cell: ({ name }) => name },
          { head: "Gap, dB of the response", cell: bar },
          { head: "Before ●", cell: (node) => decibels(node.before_db), number: true },
          { head: "After ◆", cell: (node) => decibels(node.after_db), number: true },
          { head: "Noise ┊", cell: (node) => decibels(node.noise_db), number: true },
          { head: "Linear", cell: (node) => percent(node.linear_share), number: true, hint: "share of the gap" },
          {
            head: "Nonlinear",
            cell: (node) => percent(node.nonlinear_share),
            number: true,
            hint: "share of the gap",
          },
        ],
        nodes,
        { caption: "Gap of each node before and after" },
      ),
    ),
    where.length
      ? section(
          "Where the missing force acts",
          table(
            [
              { head: "At", cell: ({ at }) => place(at) },
              { head: "Share of its power", cell: ({ share }) => percent(share), number: true },
              {
                head: "Band",
                cell: ({ band_hz: band }) => (band ? `${hertz(band[0])} to ${hertz(band[1])}` : "–"),
              },
            ],
            where,
            { caption: "Places" },
          ),
        )
      : null,
    alternatives.length
      ? section("Alternatives", table(causeColumns, alternatives, { caption: "Alternatives" }))
      : null,
  ];
}

/** The report opens in a tab of its own; where a key is needed it is saved, as a link cannot send one. */
function report(job) {
  if (!job.report) return null;
  const from = path("diagnoses", job.id);
  if (key())
    return actionButton("Save the report", () => download(`${from}/report`, `${job.request.rig}-diagnosis.html`));
  return h(
    "a",
    {
      class: "button primary",
      href: `${ROOT}${from}/report`,
      target: "_blank",
      rel: "noopener",
      "data-key": "report",
    },
    "The report",
  );
}

/** Before, after and noise of a node on a scale from -80 to 0 dB, but what has no figure; they stand beside it. */
export function bar({ before_db: before, after_db: after, noise_db: noise }) {
  const x = (level) => 200 * Math.min(1, Math.max(0, 1 + level / 80));
  return svg(
    "svg",
    { viewBox: "0 0 200 18", class: "gap", "aria-hidden": "true" },
    svg("path", { d: "M0 9H200", class: "scale" }),
    noise !== null && svg("path", { d: `M${x(noise)} 1V17`, class: "noise" }),
    before !== null && after !== null && svg("path", { d: `M${x(before)} 9H${x(after)}`, class: "change" }),
    before !== null && svg("circle", { cx: x(before), cy: 9, r: 5, class: "before" }),
    after !== null && svg("path", { d: `M${x(after)} 3l6 6l-6 6l-6 -6z`, class: "after" }),
  );
}
