// Light or dark: what the system says, or what was chosen here.

const KEY = "creak-theme";
const NEXT = { auto: "dark", dark: "light", light: "auto" };
const listeners = new Set();

export const chosen = () => localStorage.getItem(KEY) ?? "auto";

function apply(theme) {
  document.documentElement.dataset.theme = theme;
  for (const listener of [...listeners]) listener();
}

/** Goes on to the next of automatic, dark and light; returns it. */
export function turn() {
  const theme = NEXT[chosen()];
  localStorage.setItem(KEY, theme);
  apply(theme);
  return theme;
}

/** Calls a function when colours have changed; returns what ends that. */
export function onTheme(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

/** The colour of a variable of the style sheet, as it is now. */
export function colour(name) {
  const probe = document.getElementById("probe");
  probe.style.color = `var(--${name})`;
  return getComputedStyle(probe).color;
}

apply(chosen());
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => apply(chosen()));
