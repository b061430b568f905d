// Elements of the page. Text only ever becomes a text node, so names of rigs and nodes may hold anything.

const SVG = "http://www.w3.org/2000/svg";

/** Makes an HTML element: h("a", { href, class, onclick }, "text", child, null). */
export function h(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

/** Makes an SVG element in the same way. */
export function svg(tag, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG, tag), attributes, children);
}

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "value") element.value = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(
    ...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false),
  );
  return element;
}

/** Replaces what an element holds, if it changed; the focus stays on the element of the same data-key. */
export function replace(container, ...children) {
  const wanted = document.createElement(container.tagName);
  wanted.append(
    ...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false),
  );
  if (same(container, wanted)) return;
  const focused = container.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  container.replaceChildren(...wanted.childNodes);
  if (focused === undefined) return;
  for (const element of container.querySelectorAll("[data-key]")) {
    if (element.dataset.key === focused) {
      element.focus({ preventScroll: true });
      return;
    }
  }
}

function same(one, other) {
  if (one.childNodes.length !== other.childNodes.length) return false;
  return [...one.childNodes].every((node, i) => node.isEqualNode(other.childNodes[i]));
}

/**
 * A table. columns: { head, cell(row), number, hint, quiet }, quiet for a head that only screen readers need;
 * mark(row): a class for the row; stacked: where there is little room, cells stand below each other, as what can
 * be done must not lie beyond the edge.
 */
export function table(columns, rows, { caption, empty = "none", mark = () => null, stacked = false } = {}) {
  if (!rows.length) return h("p", { class: "empty" }, empty);
  const kind = (column) => (column.number ? "number" : null);
  const head = columns.map((column) =>
    h(
      "th",
      { role: "columnheader", scope: "col", class: kind(column), title: column.hint },
      column.quiet ? h("span", { class: "hidden" }, column.head) : column.head,
    ),
  );
  const cell = (row) => (column) =>
    h(
      "td",
      { role: "cell", class: kind(column), "data-head": column.quiet ? null : column.head },
      column.cell(row),
    );
  const body = rows.map((row) => h("tr", { role: "row", class: mark(row) }, columns.map(cell(row))));
  return h(
    "div",
    { class: stacked ? "table stacked" : "table", tabindex: "0", role: "region", "aria-label": caption },
    h(
      "table",
      { role: "table" }, // said, as stacked ones are laid out as something else
      h("caption", { class: "hidden" }, caption),
      h("thead", { role: "rowgroup" }, h("tr", { role: "row" }, head)),
      h("tbody", { role: "rowgroup" }, body),
    ),
  );
}

/** Terms with their values, as pairs; those without a value are left out. */
export function facts(pairs) {
  const shown = pairs.filter(([, value]) => value !== null && value !== undefined && value !== "");
  return h(
    "dl",
    { class: "facts" },
    shown.map(([term, value]) => h("div", {}, h("dt", {}, term), h("dd", {}, value))),
  );
}

/** A part of a page under a heading. */
export function section(title, ...children) {
  return h("section", { class: "card" }, h("h2", {}, title), children);
}
