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
 * @param {any} value undefined where the layout has none
 * @param {{id: string, change: (value: any) => void}} how
 */
function fieldOf(field, value, { id, change }) {
  const label = words(field.key);
  if (field.kind === "boolean") {
    const box = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", id }));
    box.checked = value ?? field.default;
    box.addEventListener("change", () => change(box.checked === field.default ? null : box.checked));
    return element("div", { class: "field check" }, element("label", {}, box, label));
  }
  const initial = textOf(field.default);
  /** @type {any} */
  let input;
  if (field.kind === "choice") {
    input = element("select", { id }, ...field.choices.map((/** @type {string} */ one) => element("option", { value: one }, one)));
    input.value = value ?? field.default;
    input.addEventListener("change", () => change(input.value === field.default ? null : input.value));
  } else {
    const list = field.suggested ? `${id}-list` : null;
    input = element("input", { type: "text", id, list, placeholder: initial || emptyWords(field), spellcheck: "false" });
    input.value = textOf(value);
    input.addEventListener("change", () => change(valueOf(field, input.value)));
  }
  const extra = [];
  if (field.suggested) extra.push(element("datalist", { id: `${id}-list` }, ...field.suggested.map((/** @type {string} */ one) => element("option", { value: one }))));
  if (field.kind === "colour") {
    const pick = /** @type {HTMLInputElement} */ (element("input", { type: "color", "aria-label": `${label}, chosen from a palette` }));
    const shown = textOf(value) || initial;
    pick.value = /^#[0-9a-f]{6}$/i.test(shown) ? shown : "#000000";
    pick.addEventListener("change", () => change(pick.value));
    extra.push(pick);
  }
  return element("div", { class: "field" }, element("label", { for: id }, label), element("span", { class: "entry" }, input, ...extra));
}

/**
 * Form of a whole layout. Groups that are open stay open, and the field that has the focus keeps it.
 * @param {HTMLElement} place
 * @param {any[]} form tables with their keys
 * @param {any} state of the layout
 * @param {{edit: (edits: any[], title: string) => void, vectors: string[]}} how
 */
export function showForm(place, form, state, { edit, vectors }) {
  const open = new Set([...place.querySelectorAll("details[open]")].map((one) => one.id));
  const focused = document.activeElement && place.contains(document.activeElement) ? document.activeElement.id : "";
  const first = !place.childElementCount;
  const groups = form.map(({ table, keys }) => {
    const id = `sheet-form-${table}`;
    const body = table === "layer" ? layersOf(keys, state.values.layer ?? [], edit, vectors) : keys.map((/** @type {any} */ field) =>
      fieldOf(field, state.values[table]?.[field.key], {
        id: `${id}-${field.key}`,
        change: (value) => edit([{ table, key: field.key, value }], `${TITLES[table].toLowerCase()}: ${words(field.key).toLowerCase()}`),
      }));
    return element("details", { id, open: open.has(id) || (first && table === "sheet") }, element("summary", {}, TITLES[table] ?? table), ...body);
  });
  place.replaceChildren(...groups);
  if (focused) document.getElementById(focused)?.focus();
}

/**
 * @param {any[]} keys
 * @param {any[]} layers
 * @param {(edits: any[], title: string) => void} edit
 * @param {string[]} vectors files that can be added
 */
function layersOf(keys, layers, edit, vectors) {
  const cards = layers.map((layer, index) => {
    const name = layer.title || layer.layer || layer.file;
    const move = (/** @type {number} */ to, /** @type {string} */ where) => edit([{ layer: "move", index, to }], `layer ${name} moved ${where}`);
    return element("div", { class: "card", role: "group", "aria-label": `Layer ${name}` },
      element("div", { class: "head" }, element("strong", { class: "grow" }, name),
        element("button", { "aria-label": `Draw ${name} below`, title: "Below", disabled: index === 0, onclick: () => move(index - 1, "down") }, "↓"),
        element("button", { "aria-label": `Draw ${name} above`, title: "Above", disabled: index === layers.length - 1, onclick: () => move(index + 1, "up") }, "↑"),
        element("button", { "aria-label": `Take ${name} off the sheet`, title: "Take off", onclick: () => edit([{ layer: "remove", index }], `layer ${name} taken off`) }, "✕")),
      ...keys.map((field) => fieldOf(field, layer[field.key], {
        id: `sheet-form-layer-${index}-${field.key}`,
        change: (value) => edit([{ table: "layer", index, key: field.key, value }], `layer ${name}: ${field.key}`),
      })));
  }).reverse(); // the uppermost first, as in the legend
  const choice = /** @type {any} */ (element("select", { "aria-label": "Vector file" }, ...vectors.map((one) => element("option", { value: one }, one))));
  const add = vectors.length
    ? element("div", { class: "tools" }, choice, element("button", { onclick: () => edit([{ layer: "add", file: choice.value }], `layer ${choice.value} added`) }, "Add layer"))
    : element("p", { class: "empty" }, "No vector file lies beside the project file.");
  return [add, ...cards];
}

/**
 * Show an error at its field, `[table] key`; what has no field is left to the message above the form.
 * @param {HTMLElement} place
 * @param {any} error null where there is none
 */
export function showError(place, error) {
  for (const one of place.querySelectorAll(".field-error")) one.remove();
  for (const one of place.querySelectorAll("[aria-invalid]")) {
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
