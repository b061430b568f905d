// Which view an address shows. Addresses are hashes, so the page needs one file and works behind any prefix.

const routes = [];

/** Adds a view under a pattern such as "/rigs/:rig". */
export function route(pattern, view) {
  routes.push([pattern.split("/").filter(Boolean), view]);
}

/** The view of a hash with the parameters of its address; null if there is none. */
export function resolve(hash) {
  let parts;
  try {
    parts = hash
      .replace(/^#?\/?/, "")
      .split("/")
      .filter(Boolean)
      .map(decodeURIComponent);
  } catch {
    return null;
  }
  for (const [pattern, view] of routes) {
    if (pattern.length !== parts.length) continue;
    if (!pattern.every((part, i) => part.startsWith(":") || part === parts[i])) continue;
    const named = pattern.flatMap((part, i) => (part.startsWith(":") ? [[part.slice(1), parts[i]]] : []));
    return { view, parameters: Object.fromEntries(named) };
  }
  return null;
}

/** The address of a view, for links: to("rigs", name, "nodes", node). */
export const to = (...parts) => `#${parts.map((part) => `/${encodeURIComponent(part)}`).join("") || "/"}`;
