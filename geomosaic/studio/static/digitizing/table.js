// Table of the features under the pictures.

import { byId, element } from "../dom.js";
import { measure } from "./form.js";

const MOST = 500; // rows that are shown
const NUMBERS = ["integer", "real"];

/** Rows of the features of a layer. */
export class FeatureTable {
  /** @param {any} tool */
  constructor(tool) {
    this.tool = tool;
    this.head = element("tr");
    this.body = element("tbody");
    this.more = element("p", { class: "faint" });
    this.find = /** @type {HTMLInputElement} */ (element("input", { type: "search", placeholder: "Find a feature", "aria-label": "Find a feature", oninput: () => this.render() }));
    byId("features-dock").append(this.find, element("table", { id: "features-table" }, element("caption", { class: "hidden" }, "Features of the layer"), element("thead", {}, this.head), this.body), this.more);
  }

  render() {
    const { layer } = this.tool;
    const fields = layer?.fields ?? [];
    const wanted = this.find.value.trim().toLowerCase();
    const found = (layer?.features ?? []).filter((/** @type {any} */ one) => !wanted || Object.values(one.values).some((value) => String(value ?? "").toLowerCase().includes(wanted)));
    this.find.hidden = (layer?.features.length ?? 0) < 12;
    const heads = ["Feature", ...fields.map((/** @type {any} */ one) => one.name), "Area", "Length"];
    this.head.replaceChildren(...heads.map((head, i) => element("th", { scope: "col", class: i > fields.length || NUMBERS.includes(fields[i - 1]?.kind) ? "number" : "", title: i > fields.length ? "On the ellipsoid" : null }, head)));
    const focused = /** @type {HTMLElement | null} */ (document.activeElement?.closest?.("#features-table tr[data-id]") ?? null)?.dataset.id;
    const rows = found.slice(0, MOST).map((/** @type {any} */ one) => this.#row(one, fields));
    const empty = !layer && this.tool.overview?.layers.length ? "The layer is being read." : !layer ? "No layer yet: create one at the left." : wanted ? "No feature has this in an attribute." : "No feature yet: press D, then click on the map or in the image.";
    this.body.replaceChildren(...(rows.length ? rows : [element("tr", {}, element("td", { colspan: heads.length, class: "empty" }, empty))]));
    this.more.textContent = found.length > MOST ? `${MOST} of ${found.length} features; find one by its attributes` : "";
    if (focused) rows.find((/** @type {any} */ row) => row.dataset.id === focused)?.focus();
  }

  mark() {
    for (const row of this.body.querySelectorAll("tr[data-id]")) row.setAttribute("aria-selected", String(/** @type {HTMLElement} */ (row).dataset.id === String(this.tool.selected)));
  }

  /**
   * @param {any} one
   * @param {any[]} fields
   */
  #row(one, fields) {
    const cells = fields.map((field) => element("td", { class: NUMBERS.includes(field.kind) ? "number" : "" }, one.values[field.name] === null ? "" : String(one.values[field.name])));
    return element("tr", { tabindex: "0", "data-id": one.id, "aria-selected": String(one.id === this.tool.selected), class: one.wrong ? "blamed" : "", title: one.wrong,
      onclick: () => this.tool.choose(one.id, true), onkeydown: (/** @type {KeyboardEvent} */ event) => this.#key(event, one.id) },
    element("th", { scope: "row" }, String(one.id)), ...cells, element("td", { class: "number" }, one.area === 0 ? "" : measure(one.area, true)), element("td", { class: "number" }, one.length === 0 ? "" : measure(one.length, false)));
  }

  /**
   * @param {KeyboardEvent} event
   * @param {number} id
   */
  #key(event, id) {
    const row = /** @type {HTMLElement} */ (event.currentTarget);
    const next = event.key === "ArrowDown" ? row.nextElementSibling : event.key === "ArrowUp" ? row.previousElementSibling : null;
    if (next) /** @type {HTMLElement} */ (next).focus();
    else if (event.key === "Enter") this.tool.choose(id, true);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
}
