// Receivers of webhooks and what was delivered to them; needs a key of scope admin where keys are needed.

import { actionButton } from "../actions.js";
import { toast } from "../dialogs.js";
import { h, replace, section, table } from "../dom.js";
import { clock } from "../format.js";
import { Problem, all, get, path, post } from "../http.js";
import { statusBadge } from "../states.js";

const POLL_MS = 5000;

export async function webhooks(root) {
  const [list, log] = [h("div", { class: "card" }), h("div")];
  root.append(h("div", { class: "title" }, h("h1", { tabindex: "-1" }, "Webhooks")), list, log);
  let chosen = null;

  async function read() {
    let found;
    try {
      found = await all("/webhooks?limit=200");
    } catch (error) {
      if (!(error instanceof Problem && error.status === 403)) throw error;
      replace(list, h("p", { class: "empty" }, `Receivers are for administrators: ${error.message}.`));
      return;
    }
    chosen ??= found[0]?.id;
    replace(
      list,
      table(
        [
          { head: "Receiver", cell: ({ url }) => h("span", { class: "comment" }, url) },
          { head: "State", cell: state },
          { head: "Events", cell: ({ events }) => events.join(", ") || "all" },
          { head: "Rigs", cell: ({ rigs }) => rigs.join(", ") || "all" },
          { head: "Waiting", cell: ({ waiting }) => waiting, number: true },
          {
            head: "Actions",
            quiet: true,
            cell: (hook) =>
              h(
                "div",
                { class: "buttons" },
                action("Deliveries", hook, async () => {
                  chosen = hook.id;
                  await read();
                }),
                hook.enabled
                  ? action("Test", hook, () =>
                      say(`${path("webhooks", hook.id)}/test`, "A test message is on its way."),
                    )
                  : action("Enable", hook, () =>
                      say(`${path("webhooks", hook.id)}/enable`, "Enabled: what waits is delivered."),
                    ),
              ),
          },
        ],
        found,
        { stacked: true, caption: "Receivers", empty: "There are no receivers. POST /api/v1/webhooks adds one." },
      ),
    );
    const hook = found.find(({ id }) => id === chosen);
    if (hook)
      replace(log, deliveries(hook, (await get(`${path("webhooks", hook.id)}/deliveries?limit=50`)).items));
  }

  async function say(where, text) {
    await post(where);
    toast(text);
    await read();
  }

  function deliveries(hook, items) {
    return section(
      `Deliveries to ${hook.url}`,
      table(
        [
          { head: "When", cell: ({ time }) => clock(time) },
          { head: "Message", cell: ({ type }) => type },
          { head: "Attempt", cell: ({ attempt }) => attempt, number: true },
          {
            head: "Outcome",
            cell: ({ outcome }) =>
              statusBadge({ delivered: "done", retried: "interrupted", failed: "failed" }[outcome], outcome),
          },
          { head: "Status", cell: ({ status_code: status }) => status ?? "–", number: true },
          { head: "Took", cell: ({ seconds }) => `${seconds.toFixed(2)} s`, number: true },
          { head: "Error", cell: ({ error }) => h("span", { class: "comment" }, error) },
          {
            head: "Actions",
            quiet: true,
            cell: ({ message, attempt }) =>
              hook.enabled &&
              actionButton(
                "Send again",
                () => say(`${path("webhooks", hook.id, "deliveries", message)}/redeliver`, "It is sent again."),
                { key: `${message} ${attempt}` },
              ),
          },
        ],
        items,
        { stacked: true, caption: "Deliveries", empty: "Nothing has been sent to it yet." },
      ),
    );
  }

  await read();
  const timer = setInterval(() => read().catch(() => {}), POLL_MS); // that it cannot be read is said above
  return { close: () => clearInterval(timer) };
}

const action = (text, { id, url }, task) =>
  actionButton(text, task, { key: `${text} ${id}`, label: `${text}: ${url}` });

function state({ enabled, reason, failing_since: since }) {
  if (!enabled) return statusBadge("failed", `disabled: ${reason}`);
  return since ? statusBadge("interrupted", `failing since ${clock(since)}`) : statusBadge("done", "enabled");
}
