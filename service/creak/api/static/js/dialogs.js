// Questions to the person, as modal dialogs; Escape closes them and the focus goes back to where it was.

import { h } from "./dom.js";

/**
 * Asks. fields: { name, label, type, value, options, required, hint, multiline }; send(values) does what is asked
 * for, and what it throws is shown. Resolves to what it returned, or to null if the person left.
 */
export function question({ title, text, fields, action, send, mandatory = false }) {
  return new Promise((done) => {
    let result = null;
    const complaint = h("p", { class: "complaint", role: "alert" });
    const inputs = fields.map(input);
    const confirm = h("button", { class: "primary", type: "submit" }, action);
    const form = h(
      "form",
      { method: "dialog" },
      h("h2", { id: "dialog-title" }, title),
      text && h("p", {}, text),
      inputs.map(({ label }) => label),
      complaint,
      h(
        "div",
        { class: "buttons" },
        !mandatory && h("button", { type: "button", onclick: () => dialog.close() }, "Cancel"),
        confirm,
      ),
    );
    const dialog = h("dialog", { "aria-labelledby": "dialog-title" }, form);
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      confirm.disabled = true;
      complaint.textContent = "";
      try {
        result = await send(Object.fromEntries(inputs.map(({ name, control }) => [name, control.value.trim()])));
        dialog.close();
      } catch (error) {
        complaint.textContent = error.message;
      } finally {
        confirm.disabled = false;
      }
    });
    if (mandatory) dialog.addEventListener("cancel", (event) => event.preventDefault());
    dialog.addEventListener("close", () => {
      dialog.remove();
      done(result);
    });
    document.body.append(dialog);
    dialog.showModal();
    (inputs.find(({ control }) => control.required && !control.value) ?? inputs[0])?.control.focus();
  });
}

function input({
  name,
  label,
  type = "text",
  value = "",
  options,
  required,
  hint,
  multiline,
  autocomplete = "off",
}) {
  const common = { name, required, value, "aria-describedby": hint ? `hint-${name}` : null };
  let control;
  if (options) {
    control = h(
      "select",
      common,
      options.map(([option, text]) => h("option", { value: option }, text)),
    );
    control.value = value;
  } else if (multiline) {
    control = h("textarea", { ...common, rows: "3", maxlength: "2000" });
  } else {
    control = h("input", { ...common, type, maxlength: "200", autocomplete, spellcheck: "false" });
  }
  return {
    name,
    control,
    label: h(
      "label",
      {},
      h("span", {}, label, !required && h("small", {}, " (optional)")),
      control,
      hint && h("small", { id: `hint-${name}` }, hint),
    ),
  };
}

/** Asks for an API key; resolves to it. */
export function askForKey(reason) {
  return question({
    title: "This service asks for a key",
    text: reason
      ? `The key was refused: ${reason}.`
      : "It is kept in this tab until the tab is closed, and nowhere else.",
    fields: [
      {
        name: "key",
        label: "API key",
        type: "password",
        required: true,
        hint: "creak key add NAME --scope operate",
      },
    ],
    action: "Use this key",
    mandatory: true,
    send: async ({ key }) => key,
  });
}

/** Shows a message for a moment, and says it to screen readers. */
export function toast(text) {
  const shown = h("p", { class: "toast" }, text);
  document.getElementById("toasts").append(shown);
  setTimeout(() => shown.remove(), 6000);
}

/** Says something to screen readers at once. */
export function announce(text) {
  document.getElementById("announcer").textContent = text;
}

/** Shows the keys that do something. */
export function showShortcuts(shortcuts) {
  const dialog = h(
    "dialog",
    { "aria-labelledby": "dialog-title" },
    h(
      "form",
      { method: "dialog" },
      h("h2", { id: "dialog-title" }, "Keyboard"),
      h(
        "dl",
        { class: "keys" },
        shortcuts.map(([keys, text]) =>
          h(
            "div",
            {},
            h(
              "dt",
              {},
              keys.split(" ").map((name) => h("kbd", {}, name)),
            ),
            h("dd", {}, text),
          ),
        ),
      ),
      h("div", { class: "buttons" }, h("button", { class: "primary" }, "Close")),
    ),
  );
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}
