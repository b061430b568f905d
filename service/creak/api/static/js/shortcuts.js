// Keys that do something anywhere on the page: g and a letter goes to a view.

import { showShortcuts } from "./dialogs.js";

const VIEWS = {
  f: ["#/", "fleet"],
  a: ["#/alarms", "alarms"],
  r: ["#/recordings", "recordings"],
  d: ["#/diagnoses", "diagnoses"],
  w: ["#/webhooks", "webhooks"],
};
const LIST = [
  ...Object.entries(VIEWS).map(([letter, [, name]]) => [`g ${letter}`, `go to ${name}`]),
  ["t", "light, dark or as the system says"],
  ["← →", "move along a chart that has the focus"],
  ["+ −", "zoom into that chart, and out"],
  ["?", "this list"],
];

export const help = () => showShortcuts(LIST);

/** Begins to listen; turnTheme is what t does. */
export function install(turnTheme) {
  let going = 0;
  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest?.("input, select, textarea, dialog");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const name = event.key.toLowerCase();
    if (Date.now() - going < 1500 && VIEWS[name]) {
      going = 0;
      location.hash = VIEWS[name][0];
    } else if (name === "g") {
      going = Date.now();
    } else if (name === "?") {
      help();
    } else if (name === "t") {
      turnTheme();
    }
  });
}
