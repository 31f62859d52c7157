// Table of the control points under the pictures.

import { byId, element } from "../dom.js";
import { length, told } from "./numbers.js";

const STATES = /** @type {Record<string, string>} */ ({ control: "control", check: "check", off: "off", outside: "beyond the part" });
const HEADS = /** @type {[string, string][]} */ ([
  ["", "On or off"], ["Point", ""], ["State", ""], ["col", ""], ["row", ""], ["x", ""], ["y", ""], ["Residual", "Length of the residual, pixels"], ["Δcol", "Pixels"], ["Δrow", "Pixels"],
  ["Left out", "Error under the fit to the others, pixels"], ["Checked", "Share of the measurement that the others check"],
  ["RMS otherwise", "RMS of the fit without this point, or with it where it is off"], ["", ""],
]);

/** Rows of the points of an image. */
export class PointTable {
  /** @param {any} control */
  constructor(control) {
    this.control = control;
    this.body = element("tbody");
    byId("dock").append(element("table", { id: "control-table" }, element("caption", { class: "hidden" }, "Control points of the image"),
      element("thead", {}, element("tr", {}, ...HEADS.map(([head, title]) => element("th", { scope: "col", title: title || null }, head)))), this.body));
  }

  clear() {
    this.body.replaceChildren();
  }

  /** @param {any[]} points */
  render(points) {
    const rows = points.map((point) => this.#row(point));
    const focused = /** @type {HTMLElement | null} */ (document.activeElement?.closest?.("#control-table tr[data-id]") ?? null)?.dataset.id;
    this.body.replaceChildren(...(rows.length ? rows : [element("tr", {}, element("td", { colspan: HEADS.length, class: "empty" }, "No point yet: press P, then click in the image and on the map."))]));
    if (focused) rows.find((row) => row.dataset.id === focused)?.focus();
  }

  /** @param {string | null} name of the point that is chosen */
  mark(name) {
    for (const row of this.body.querySelectorAll("tr[data-id]")) row.setAttribute("aria-selected", String(/** @type {HTMLElement} */ (row).dataset.id === name));
  }

  /** @param {any} point */
  #row(point) {
    const { control } = this;
    const box = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", "aria-label": `Point ${point.id} takes part`, onchange: () => control.change(point, { enabled: box.checked }) }));
    box.checked = point.enabled;
    const part = point.redundancy ? Math.min(...point.redundancy) : null;
    const numbers = [told(point.col, 2), told(point.row, 2), point.ground[0], point.ground[1],
      told(length(point.residual), 2), told(point.residual?.[0], 2), told(point.residual?.[1], 2),
      told(length(point.left_out), 2), part === null ? "–" : `${Math.round(100 * part)} %`, told(point.toggled?.rms, 2)];
    const row = element("tr", { tabindex: "0", "data-id": point.id, "aria-selected": String(point.id === control.selected), class: point.blamed ? "blamed" : point.state,
      onclick: () => control.select(point.id, true), onkeydown: (/** @type {KeyboardEvent} */ event) => this.#key(event, point.id) },
      element("td", {}, box), element("th", { scope: "row" }, point.id), element("td", {}, STATES[point.state]),
      ...numbers.map((text) => element("td", { class: "number" }, text)),
      element("td", {}, element("button", { "aria-label": `Take point ${point.id} out`, title: "Take out", onclick: (/** @type {Event} */ event) => { event.stopPropagation(); control.remove(point); } }, "✕")));
    box.addEventListener("click", (event) => event.stopPropagation());
    return row;
  }

  /**
   * @param {KeyboardEvent} event
   * @param {string} name
   */
  #key(event, name) {
    const row = /** @type {HTMLElement} */ (event.currentTarget);
    const next = event.key === "ArrowDown" ? row.nextElementSibling : event.key === "ArrowUp" ? row.previousElementSibling : null;
    if (next) /** @type {HTMLElement} */ (next).focus();
    else if (event.key === "Enter") this.control.select(name, true);
    else return;
    event.preventDefault();
  }
}
