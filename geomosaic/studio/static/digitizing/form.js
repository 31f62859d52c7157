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
    this.made = ""; // what the fields were made for
    /** @type {any} */
    this.feature = null; // that is shown
    /** @type {{name: string, show: (value: any) => void, node: HTMLElement}[]} */
    this.rows = [];
    this.figures = element("p", { class: "faint", title: "On the ellipsoid of the layer's CRS" });
    this.wrong = element("p", { class: "bad" });
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
    const made = chosen ? JSON.stringify([layer.id, layer.fields, chosen.id]) : "";
    if (made !== this.made) {
      this.rows = chosen ? layer.fields.map((/** @type {any} */ field) => this.#row(field)) : [];
      this.box.replaceChildren(...(!chosen ? [] : [
        element("div", { class: "head" }, element("span", {}, element("strong", {}, `Feature ${chosen.id}`)), element("button", { type: "button", id: "features-delete", onclick: () => this.tool.edits.remove() }, "Delete")),
        this.figures, this.wrong, ...this.rows.map((one) => one.node), this.rows.length ? "" : element("p", { class: "faint" }, "The layer has no attributes."),
      ]));
    }
    this.made = made;
    this.feature = chosen;
    this.box.hidden = !chosen;
    if (!chosen) return;
    this.figures.textContent = [chosen.area ? `area ${measure(chosen.area, true)}` : null, chosen.length ? `${chosen.area || layer.kind.includes("POLYGON") ? "outline" : "length"} ${measure(chosen.length, false)}` : null].filter(Boolean).join(", ");
    this.wrong.textContent = chosen.wrong ?? "";
    this.wrong.hidden = !chosen.wrong;
    for (const { name, show } of this.rows) show(chosen.values[name]);
  }

  /**
   * Field of an attribute; what is being written in it stays.
   * @param {any} field
   */
  #row({ name, kind, longest }) {
    const id = `feature-field-${name.replace(/\W/g, "-")}`;
    const input = /** @type {HTMLInputElement} */ (element("input", { type: TYPES[kind], id, name, step: kind === "real" ? "any" : null, maxlength: longest }));
    const show = (/** @type {any} */ value) => {
      if (kind === "boolean") {
        input.checked = value === true;
        input.indeterminate = value === null;
        return;
      }
      const text = value === null ? "" : kind === "datetime" ? String(value).slice(0, 16) : String(value);
      if (text === input.defaultValue) return;
      const written = document.activeElement === input && input.value !== input.defaultValue;
      input.defaultValue = text;
      if (!written) input.value = text;
    };
    input.addEventListener("change", () => this.tool.edits.setValues(this.feature, { [name]: kind === "boolean" ? input.checked : input.value }));
    return { name, show, node: element("div", { class: "field" }, element("label", { for: id }, name), input) };
  }
}
