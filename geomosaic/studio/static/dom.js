// Elements made in code: whatever a file says becomes text, never markup.

/**
 * Element with attributes, listeners ("onclick": function) and children.
 * @param {string} tag
 * @param {Record<string, any>} [attributes] null, undefined and false are left out
 * @param {...(Node | string | null | undefined)} children
 * @returns {HTMLElement}
 */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : String(value));
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

/**
 * Element of the page by its id.
 * @param {string} id
 * @returns {any}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element '${id}'`);
  return found;
}

/**
 * The first of some ids that a list has, else that of its first entry; empty where the list is.
 * @param {string[]} ids
 * @param {{id: string}[]} list
 */
export const firstThere = (ids, list) => ids.find((id) => list.some((one) => one.id === id)) ?? list[0]?.id ?? "";

/**
 * Number with as many decimals, grouped by thin spaces.
 * @param {number} value
 * @param {number} decimals
 * @returns {string}
 */
export function shown(value, decimals) {
  return value.toLocaleString("en", { minimumFractionDigits: decimals, maximumFractionDigits: decimals }).replaceAll(",", "\u202f");
}
