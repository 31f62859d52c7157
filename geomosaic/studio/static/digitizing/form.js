// Attributes of the chosen feature, each saved as it is changed.

import { element } from "../dom.js";

const TYPES = /** @type {Record<string, string>} */ ({ text: "text", integer: "number", real: "number", boolean: "checkbox", date: "date", datetime: "datetime-local" });

/**
 * Area or length with a unit, grouped.
 * @param {number | null} value square metres or metres
 * @param {boolean} area
 */
export function measure(value, area) {
  if (value === null || value === undefined) return "–";
  const [large, unit, big] = area ? [1e6, "m²", "km²"] : [1e4, "m", "km"];
  const [shown, name] = value >= large ? [value / (area ? 1e6 : 1e3), big] : [value, unit];
  return `${shown.toLocaleString("en", { maximumFractionDigits: shown < 100 ? 2 : 1 }).replaceAll(",", "\u202f")} ${name}`;
}

/** Form of a feature. */
export class FeatureForm {
  box = element("form", { id: "features-form", class: "card", onsubmit: (/** @type {Event} */ event) => event.preventDefault() });

  /** @param {any} tool */
  constructor(tool) {
    this.tool = tool;
    this.shown = "";
    /** @type {HTMLElement} where keys are again after the form */
    this.canvas = tool.map.view.canvas;
    /** @type {HTMLElement | null} picture in which a feature was drawn whose attributes get the keys once they are shown */
    this.waiting = null;
    this.box.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.#key(event));
  }

  /**
   * Go to the first attribute of what was drawn; Enter saves it and goes back to the picture, Escape goes back without it.
   * The keys stay where somebody draws already, or has gone to.
   */
  #takeKeys() {
    const { waiting } = this;
    this.waiting = null;
    if (!waiting || this.tool.sketch.going || ![waiting, document.body].includes(/** @type {any} */ (document.activeElement))) return;
    this.canvas = waiting;
    /** @type {HTMLElement | null} */ (this.box.querySelector("input"))?.focus();
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const input = /** @type {HTMLInputElement} */ (event.target);
    if (!input.matches("input") || !["Enter", "Escape"].includes(event.key)) return;
    if (event.key === "Escape") input.value = input.defaultValue;
    event.preventDefault();
    event.stopPropagation();
    this.canvas.focus(); // which saves what was typed
  }

  render() {
    this.#render();
    this.#takeKeys();
  }

  #render() {
    const { layer, chosen } = this.tool;
    const key = JSON.stringify([layer?.id, layer?.fields, chosen && { ...chosen, image: null, map: null, drawn: null }]);
    if (key === this.shown) return; // what is being written stays
    const focused = /** @type {HTMLInputElement | null} */ (this.box.contains(document.activeElement) ? document.activeElement : null)?.name;
    this.shown = key;
    this.box.hidden = !chosen;
    if (!chosen) return void this.box.replaceChildren();
    const rows = layer.fields.map((/** @type {any} */ field) => this.#row(field, chosen.values[field.name]));
    const figures = [chosen.area ? `area ${measure(chosen.area, true)}` : null, chosen.length ? `${chosen.area || layer.kind.includes("POLYGON") ? "outline" : "length"} ${measure(chosen.length, false)}` : null].filter(Boolean).join(", ");
    this.box.replaceChildren(
      element("div", { class: "head" }, element("span", {}, element("strong", {}, `Feature ${chosen.id}`)), element("button", { type: "button", id: "features-delete", onclick: () => this.tool.edits.remove() }, "Delete")),
      element("p", { class: "faint", title: "On the ellipsoid of the layer's CRS" }, figures), chosen.wrong ? element("p", { class: "bad" }, chosen.wrong) : "",
      ...rows, rows.length ? "" : element("p", { class: "faint" }, "The layer has no attributes."),
    );
    if (focused) /** @type {HTMLElement | null} */ ([...this.box.querySelectorAll("input")].find((one) => one.name === focused) ?? null)?.focus();
  }

  /**
   * @param {any} field
   * @param {any} value
   */
  #row(field, value) {
    const id = `feature-field-${field.name.replace(/\W/g, "-")}`;
    const input = /** @type {HTMLInputElement} */ (element("input", { type: TYPES[field.kind], id, name: field.name, step: field.kind === "real" ? "any" : null, maxlength: field.longest }));
    if (field.kind === "boolean") {
      input.checked = value === true;
      input.indeterminate = value === null;
    } else input.defaultValue = value === null ? "" : field.kind === "datetime" ? String(value).slice(0, 16) : String(value);
    input.addEventListener("change", () => this.tool.edits.setValues({ [field.name]: field.kind === "boolean" ? input.checked : input.value }));
    return element("div", { class: "field" }, element("label", { for: id }, field.name), input);
  }
}
