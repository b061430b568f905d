// Asking the API: the key that may be needed, problems as errors, lists page by page.

export const ROOT = "api/v1";
const KEY = "creak-key";

let ask = null; // asks the person for a key, once at a time
let offset = 0; // of the server's clock, ms

/** What the API answered instead of what was asked for (RFC 9457). */
export class Problem extends Error {
  constructor(status, body) {
    super(body.detail || body.title || `status ${status}`);
    this.status = status;
    this.kind = (body.type ?? "").split(":").pop();
  }
}

/** The server cannot be reached at all. */
export class Unreachable extends Error {
  constructor() {
    super("the service cannot be reached");
  }
}

export const key = () => sessionStorage.getItem(KEY);

/** Forgets the key, so that the next request asks for another one. */
export function forgetKey() {
  sessionStorage.removeItem(KEY);
}

/** The server's time, ms since the epoch. */
export const now = () => Date.now() + offset;

/** Sets what asks for a key: a function of a reason that resolves to the key that was typed in. */
export function askWith(dialog) {
  let asked = null;
  ask = (reason) => {
    asked ??= dialog(reason)
      .then((typed) => {
        sessionStorage.setItem(KEY, typed);
      })
      .finally(() => {
        asked = null;
      });
    return asked;
  };
}

/** Fetches a path below the API's root, with the key; anything but success is thrown. */
export async function request(path, { method = "GET", body, headers = {}, signal } = {}) {
  for (;;) {
    const used = key();
    let answer;
    try {
      answer = await fetch(`${ROOT}${path}`, {
        method,
        signal,
        cache: "no-store",
        credentials: "omit",
        body: body === undefined ? undefined : JSON.stringify(body),
        headers: {
          ...(body === undefined ? {} : { "Content-Type": "application/json" }),
          ...(used ? { Authorization: `Bearer ${used}` } : {}),
          ...headers,
        },
      });
    } catch (error) {
      if (error.name === "AbortError") throw error;
      throw new Unreachable();
    }
    const date = Date.parse(answer.headers.get("Date") ?? "");
    if (date) offset = Math.abs(date - Date.now()) > 2000 ? date - Date.now() : 0;
    if (answer.ok || answer.status === 304) return answer;
    const problem = new Problem(answer.status, await answer.json().catch(() => ({})));
    if (answer.status !== 401 || !ask) throw problem;
    if (used === key()) await ask(used ? problem.message : ""); // else another request has asked meanwhile
  }
}

/** A JSON body. */
export async function get(path, options) {
  return (await request(path, options)).json();
}

export async function post(path, body, headers) {
  return (await request(path, { method: "POST", body, headers })).json();
}

/** All items of a list, up to a number of them. */
export async function all(path, most = 10000) {
  const items = [];
  let cursor = null;
  do {
    const mark = path.includes("?") ? "&" : "?";
    const page = await get(cursor ? `${path}${mark}cursor=${encodeURIComponent(cursor)}` : path);
    items.push(...page.items);
    cursor = page.next;
  } while (cursor && items.length < most);
  return items;
}

/** A path below the API's root; its parts may hold anything. */
export const path = (...parts) => parts.map((part) => `/${encodeURIComponent(part)}`).join("");

/** Saves what lies at a path as a file; without a key the browser does it by itself. */
export async function download(from, name) {
  const link = document.createElement("a");
  link.download = name;
  if (key()) {
    link.href = URL.createObjectURL(await (await request(from)).blob());
    setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  } else {
    link.href = `${ROOT}${from}`;
  }
  link.click();
}
