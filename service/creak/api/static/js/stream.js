// The event stream over fetch, as an EventSource cannot send a key. It resumes where it was cut off.

import { request } from "./http.js";

const SILENCE_MS = 60_000; // the service sends a comment every quarter of a minute or so
const LONGEST_MS = 10_000;

/** Parses server-sent events: takes text as it comes, gives whole events { id, event, data }. */
export class Parser {
  #rest = "";
  #event = {};

  *take(text) {
    const lines = (this.#rest + text).split(/\r\n|\n|\r(?!$)/);
    this.#rest = lines.pop();
    for (const line of lines) {
      if (line === "") {
        if (this.#event.data !== undefined) yield this.#event;
        this.#event = {};
        continue;
      }
      const [, field, value] = /^([^:]*):? ?(.*)$/s.exec(line);
      if (field === "data")
        this.#event.data = this.#event.data === undefined ? value : `${this.#event.data}\n${value}`;
      else if (field) this.#event[field] = value;
    }
  }
}

/**
 * Listens for good. on: { open(resumed), event(kind, data), closed(error, waitMs) }.
 */
export async function listen(on) {
  let last = null;
  let wait = 0;
  for (;;) {
    const stop = new AbortController();
    let watchdog = null;
    const heard = () => {
      clearTimeout(watchdog);
      watchdog = setTimeout(() => stop.abort(), SILENCE_MS);
    };
    let failure = null;
    try {
      heard();
      const headers = { Accept: "text/event-stream", ...(last === null ? {} : { "Last-Event-ID": last }) };
      const answer = await request("/events", { headers, signal: stop.signal });
      on.open(last !== null);
      wait = 0;
      const parser = new Parser();
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      for (;;) {
        const { done, value } = await reader.read();
        if (done) break;
        heard();
        for (const { id, event, data } of parser.take(value)) {
          if (id !== undefined) last = id;
          on.event(event ?? "message", JSON.parse(data));
        }
      }
    } catch (error) {
      failure = error;
    } finally {
      clearTimeout(watchdog);
    }
    wait = Math.min(wait ? 2 * wait : 1000, LONGEST_MS);
    on.closed(failure, wait);
    await new Promise((done) => setTimeout(done, wait));
  }
}
