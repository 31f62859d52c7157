// Form of a layout, made from its declaration: a field for each key, errors at the field.

import { element } from "../dom.js";

const TITLES = /** @type {Record<string, string>} */ ({
  sheet: "Sheet and paper", map: "Map", enhance: "Enhancement", grid: "Grid", graticule: "Graticule", scalebar: "Scale bar", north: "North arrows",
  legend: "Legend", notes: "Notes", contours: "Contours", layer: "Layers",
});

/** @param {string} key */
const words = (key) => (key[0].toUpperCase() + key.slice(1)).replaceAll("_", " ");

/**
 * Value that a field's text means; undefined where it means none.
 * @param {any} field
 * @param {string} text
 * @returns {any}
 */
function valueOf(field, text) {
  if (!text.trim()) return null;
  const number = (/** @type {string} */ part) => (part.trim() && Number.isFinite(Number(part)) ? Number(part) : part.trim());
  if (field.kind === "list") {
    const parts = text.split(/[\s,;]+/).filter(Boolean);
    return field.of === "text" ? text.split(",").map((part) => part.trim()).filter(Boolean) : parts.map(number);
  }
  return field.kind === "number" || field.kind === "integer" ? number(text) : text;
}

/** What an empty field means. @param {any} field */
const emptyWords = (field) => (field.position ? "usual place" : field.kind === "text" || field.count === null ? "none" : "automatic");

/** @param {any} value */
const textOf = (value) => (value === null || value === undefined ? "" : Array.isArray(value) ? value.join(", ") : String(value));

/**
 * Field of one key.
 * @param {any} field as the server declares it
 * @param {{id: string, change: (value: any) => void}} how
 * @returns {{node: HTMLElement, show: (value: any) => void}} `show` takes the layout's value, undefined where it has none
 */
function fieldOf(field, { id, change }) {
  const label = words(field.key);
  if (field.kind === "boolean") {
    const box = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", id }));
    box.addEventListener("change", () => change(box.checked === field.default ? null : box.checked));
    return { node: element("div", { class: "field check" }, element("label", {}, box, label)), show: (value) => { box.checked = value ?? field.default; } };
  }
  const initial = textOf(field.default);
  /** @type {any} */
  let input;
  /** @type {(value: any) => void} */
  let show;
  if (field.kind === "choice") {
    input = element("select", { id }, ...field.choices.map((/** @type {string} */ one) => element("option", { value: one }, one)));
    input.addEventListener("change", () => change(input.value === field.default ? null : input.value));
    show = (value) => { input.value = value ?? field.default; };
  } else {
    const list = field.suggested ? `${id}-list` : null;
    input = element("input", { type: "text", id, list, placeholder: initial || emptyWords(field), spellcheck: "false" });
    let saved = ""; // text of the layout's value
    let typing = false; // whether that came while something else was being typed, which stays
    show = (value) => {
      if (textOf(value) === saved) return;
      typing = document.activeElement === input && input.value !== saved;
      saved = textOf(value);
      if (!typing) input.value = saved;
    };
    input.addEventListener("input", () => { input.dataset.typed = "1"; });
    input.addEventListener("change", () => {
      typing = false;
      delete input.dataset.typed;
      change(valueOf(field, input.value));
    });
    input.addEventListener("blur", () => { if (typing) input.value = saved; });
  }
  const extra = [];
  if (field.suggested) extra.push(element("datalist", { id: `${id}-list` }, ...field.suggested.map((/** @type {string} */ one) => element("option", { value: one }))));
  if (field.kind === "colour") {
    const pick = /** @type {HTMLInputElement} */ (element("input", { type: "color", "aria-label": `${label}, chosen from a palette` }));
    pick.addEventListener("change", () => change(pick.value));
    extra.push(pick);
    const showText = show;
    show = (value) => {
      showText(value);
      const shown = textOf(value) || initial;
      pick.value = /^#[0-9a-f]{6}$/i.test(shown) ? shown : "#000000";
    };
  }
  return { node: element("div", { class: "field" }, element("label", { for: id }, label), element("span", { class: "entry" }, input, ...extra)), show };
}

const nameOf = (/** @type {any} */ layer) => layer.title || layer.layer || layer.file;

/** Form of a whole layout. It is made for a layout and the names of its layers; other values go into its fields. */
export class LayoutForm {
  place = element("div", { id: "sheet-form" });
  made = ""; // what the form was made for
  /** @type {{show: (value: any) => void, of: (values: any) => any}[]} */
  fields = [];

  /** @param {(edits: any[], title: string) => void} edit */
  constructor(edit) {
    this.edit = edit;
  }

  /** @param {string} text instead of a form */
  empty(text) {
    this.made = "";
    this.place.replaceChildren(element("p", { class: "empty" }, text));
    this.place.removeAttribute("inert");
  }

  /**
   * @param {any[]} form tables with their keys
   * @param {any} state of the layout
   * @param {string[]} vectors files that can be added
   */
  show(form, state, vectors) {
    const layers = state.values.layer ?? [];
    const made = JSON.stringify([state.id, vectors, layers.map((/** @type {any} */ one) => [nameOf(one), one.file, one.layer])]);
    if (made !== this.made) this.#make(form, layers, vectors);
    this.made = made;
    for (const { show, of } of this.fields) show(of(state.values));
    this.place.toggleAttribute("inert", !state.editable);
  }

  /**
   * Make the fields. Groups that are open stay open, and the field that has the focus keeps it.
   * @param {any[]} form
   * @param {any[]} layers
   * @param {string[]} vectors
   */
  #make(form, layers, vectors) {
    const open = new Set([...this.place.querySelectorAll("details[open]")].map((one) => one.id));
    const active = /** @type {any} */ (document.activeElement);
    const focused = this.place.contains(active) ? active.id : "", typed = active?.dataset.typed && active.value;
    const layerOf = (/** @type {any} */ one) => one?.closest("[data-of]")?.dataset.of;
    const own = layerOf(active);
    if (typed) active.value = ""; // half a value is not saved as it goes
    const first = !this.place.querySelector("details");
    this.fields = [];
    const groups = form.map(({ table, keys }) => {
      const id = `sheet-form-${table}`;
      const title = TITLES[table] ?? table;
      const body = table === "layer" ? this.#layers(keys, layers, vectors) : keys.map((/** @type {any} */ field) => this.#field(field, `${id}-${field.key}`, (values) => values[table],
        (value) => this.edit([{ table, key: field.key, value }], `${title.toLowerCase()}: ${words(field.key).toLowerCase()}`)));
      return element("details", { id, open: open.has(id) || (first && table === "sheet") }, element("summary", {}, title), ...body);
    });
    this.place.replaceChildren(...groups);
    const again = /** @type {any} */ (focused && document.getElementById(focused));
    if (!again) return;
    again.focus();
    if (!typed || layerOf(again) !== own) return;
    again.value = typed; // which the field takes for its own when it is left
    again.addEventListener("blur", () => again.dispatchEvent(new Event("change")), { once: true, capture: true });
  }

  /**
   * @param {any} field
   * @param {string} id
   * @param {(values: any) => any} table of the values that has the key
   * @param {(value: any) => void} change
   */
  #field(field, id, table, change) {
    const { node, show } = fieldOf(field, { id, change });
    this.fields.push({ show, of: (values) => table(values)?.[field.key] });
    return node;
  }

  /**
   * @param {any[]} keys
   * @param {any[]} layers
   * @param {string[]} vectors
   */
  #layers(keys, layers, vectors) {
    const cards = layers.map((layer, index) => {
      const name = nameOf(layer), of = [layer.file ?? null, layer.layer ?? null];
      const move = (/** @type {number} */ to, /** @type {string} */ where) => this.edit([{ layer: "move", index, of, to }], `layer ${name} moved ${where}`);
      return element("div", { class: "card", role: "group", "aria-label": `Layer ${name}`, "data-of": JSON.stringify(of) },
        element("div", { class: "head" }, element("strong", { class: "grow" }, name),
          element("button", { "aria-label": `Draw ${name} below`, title: "Below", disabled: index === 0, onclick: () => move(index - 1, "down") }, "↓"),
          element("button", { "aria-label": `Draw ${name} above`, title: "Above", disabled: index === layers.length - 1, onclick: () => move(index + 1, "up") }, "↑"),
          element("button", { "aria-label": `Take ${name} off the sheet`, title: "Take off", onclick: () => this.edit([{ layer: "remove", index, of }], `layer ${name} taken off`) }, "✕")),
        ...keys.map((field) => this.#field(field, `sheet-form-layer-${index}-${field.key}`, (values) => values.layer?.[index],
          (value) => this.edit([{ table: "layer", index, of, key: field.key, value }], `layer ${name}: ${field.key}`))));
    }).reverse(); // the uppermost first, as in the legend
    const choice = /** @type {any} */ (element("select", { "aria-label": "Vector file" }, ...vectors.map((one) => element("option", { value: one }, one))));
    const add = vectors.length
      ? element("div", { class: "tools" }, choice, element("button", { onclick: () => this.edit([{ layer: "add", file: choice.value }], `layer ${choice.value} added`) }, "Add layer"))
      : element("p", { class: "empty" }, "No vector file lies beside the project file.");
    return [add, ...cards];
  }

  /**
   * Show an error at its field, `[table] key`; what has no field is left to the message above the form.
   * @param {any} error null where there is none
   */
  tell(error) {
    for (const one of this.place.querySelectorAll(".field-error")) one.remove();
    for (const one of this.place.querySelectorAll("[aria-invalid]")) {
      one.removeAttribute("aria-invalid");
      one.removeAttribute("aria-describedby");
    }
    if (!error) return;
    const [, table, key] = /\[+(\w+)\]+(?:\s+(\w+))?/.exec(error.where ?? "") ?? [];
    const named = key ?? /`(\w+)`/.exec(error.what)?.[1];
    const group = table ? document.getElementById(`sheet-form-${table}`) : null;
    if (!group) return;
    group.setAttribute("open", "");
    const input = document.getElementById(`sheet-form-${table}-${named}`) ?? group.querySelector(`[id$="-${CSS.escape(named ?? "")}"]`);
    if (!input) return;
    input.setAttribute("aria-invalid", "true");
    input.setAttribute("aria-describedby", "sheet-field-error");
    input.closest(".field")?.append(element("p", { class: "field-error bad", id: "sheet-field-error" }, [error.what, error.hint].filter(Boolean).join("; ")));
  }
}
