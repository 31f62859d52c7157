// Panels of the side: images, layers, steps, messages. They show what the studio holds and call what it offers.

import { byId, element } from "./dom.js";

// Pixels along the side of a tile, and of a thumbnail in the list.
const TILE = 256;
const FRAME = [64, 48];

/**
 * Tabs of the side, by ARIA's pattern: arrow keys go from tab to tab.
 * @param {{id: string, title: string}[]} tabs
 * @returns {{panel: (id: string) => HTMLElement, select: (id: string) => void, count: (id: string, text: string, bad?: boolean) => void,
 *   onselect: (id: string) => void}} `onselect` is called with the tab that is shown
 */
export function sideTabs(tabs) {
  const list = byId("tabs");
  const panels = byId("panels");
  const select = (/** @type {string} */ id) => {
    for (const tab of list.children) {
      const chosen = tab.id === `tab-${id}`;
      tab.setAttribute("aria-selected", String(chosen));
      tab.tabIndex = chosen ? 0 : -1;
      byId(tab.getAttribute("aria-controls")).hidden = !chosen;
    }
    made.onselect(id);
  };
  for (const { id, title } of tabs) {
    const count = element("span", { class: "count", id: `count-${id}` });
    const tab = element("button", {
      role: "tab", id: `tab-${id}`, "aria-controls": `panel-${id}`, onclick: () => select(id),
    }, title, count);
    list.append(tab);
    panels.append(element("div", { role: "tabpanel", id: `panel-${id}`, "aria-labelledby": `tab-${id}`, tabindex: "-1" }));
  }
  list.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
    const step = { ArrowDown: 1, ArrowRight: 1, ArrowUp: -1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const every = [...list.children];
    const next = every[(every.indexOf(document.activeElement) + step + every.length) % every.length];
    next.click();
    next.focus();
    event.preventDefault();
  });
  /** @type {any} */
  const made = {
    onselect: () => {},
    panel: (/** @type {string} */ id) => byId(`panel-${id}`),
    select,
    count: (/** @type {string} */ id, /** @type {string} */ text, bad = false) => {
      byId(`count-${id}`).textContent = text;
      byId(`count-${id}`).classList.toggle("bad", bad);
    },
  };
  select(tabs[0].id);
  return made;
}

/**
 * State of an image in words, and how it looks.
 * @param {any} image
 * @returns {[string, string]}
 */
function stateOf(image) {
  if (image.error) return [image.error, "bad"];
  if (image.set_aside) return ["set aside", "warn"];
  return image.oriented ? ["oriented", "good"] : ["not oriented yet", ""];
}

/**
 * Picture of an image: the part of its coarsest tile that it fills.
 * @param {any} image
 */
function thumbnail(image) {
  const frame = element("span", { class: "thumbnail" });
  if (image.error) return frame;
  const picture = element("img", { alt: "", loading: "lazy", src: `/tiles/${image.id}/0/0/0.webp` });
  const reduced = Math.max(1, 2 ** Math.ceil(Math.log2(Math.max(image.width, image.height) / TILE)));
  const scale = Math.max(FRAME[0] / (image.width / reduced), FRAME[1] / (image.height / reduced));
  picture.style.width = `${TILE * scale}px`;
  frame.append(picture);
  return frame;
}

/**
 * List of the images; the chosen one is marked.
 * @param {HTMLElement} panel
 * @param {any[]} images
 * @param {string | null} chosen id
 * @param {(image: any) => void} choose
 */
export function showImages(panel, images, chosen, choose) {
  if (panel.dataset.shown !== JSON.stringify(images)) {
    panel.dataset.shown = JSON.stringify(images);
    const find = /** @type {HTMLInputElement} */ (element("input", { type: "search", placeholder: "Find an image", "aria-label": "Find an image" }));
    const rows = images.map((image) => {
      const [state, look] = stateOf(image);
      const size = image.width ? `${image.width} × ${image.height}, ${image.bands} × ${image.dtype}` : "";
      const picture = thumbnail(image);
      return element("li", {}, element("button", { class: "row", "data-id": image.id, onclick: () => choose(image) }, picture,
        element("span", { class: "words" }, element("span", {}, image.name), element("small", {}, size), element("small", { class: look }, state))));
    });
    find.addEventListener("input", () => {
      for (const [i, row] of rows.entries()) row.hidden = !images[i].name.toLowerCase().includes(find.value.toLowerCase());
    });
    const list = element("ul", { class: "list" }, ...rows);
    panel.replaceChildren(images.length > 8 ? find : "", images.length ? list : element("p", { class: "empty" }, "The project has no images."));
  }
  for (const row of panel.querySelectorAll(".row")) {
    row.setAttribute("aria-current", String(row.getAttribute("data-id") === chosen));
  }
}

const ROLES = /** @type {Record<string, string>} */ ({
  mosaic: "mosaic", before: "kept for comparison", ortho: "ortho", reference: "reference", dem: "heights", sheet: "map sheet", lines: "drawn over the map", base: "tiles of the web",
});

/**
 * List of the map's layers, each with a switch and its opacity.
 * @param {HTMLElement} panel
 * @param {{layer: any, drawn: any, why: string | null}[]} entries `drawn` is OpenLayers' layer, null where there is none
 * @param {(layer: any) => void} open opens a raster as an image
 * @param {(layer: any) => void} makeMap shows the map in the raster's CRS
 */
export function showLayers(panel, entries, open, makeMap) {
  const cards = entries.map(({ layer, drawn, why }) => {
    const about = [ROLES[layer.role], layer.width ? `${layer.width} × ${layer.height}` : null, layer.crs_name].filter(Boolean).join(", ");
    if (!drawn) {
      const button = layer.error ? null : element("button", { onclick: () => open(layer) }, "Open as an image");
      const map = layer.on_map ? element("button", { onclick: () => makeMap(layer) }, "Make it the map") : null;
      return element("li", { class: "card" }, element("div", { class: "head" }, element("span", { title: layer.name }, layer.name), button, map),
        element("small", {}, about), element("p", { class: "warn" }, why ?? ""));
    }
    const shownBox = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox" }));
    shownBox.checked = drawn.getVisible();
    shownBox.addEventListener("change", () => drawn.setVisible(shownBox.checked));
    const opacity = /** @type {HTMLInputElement} */ (element("input", { type: "range", min: 0, max: 100, "aria-label": `Opacity of ${layer.name}` }));
    opacity.value = String(Math.round(100 * drawn.getOpacity()));
    opacity.addEventListener("input", () => drawn.setOpacity(Number(opacity.value) / 100));
    return element("li", { class: "card" }, element("div", { class: "head" }, element("label", { title: layer.name }, shownBox, layer.name)),
      element("small", {}, about), opacity);
  });
  panel.replaceChildren(cards.length
    ? element("ul", { class: "list" }, ...cards)
    : element("p", { class: "empty" }, "No mosaic and no reference yet. `geomosaic run` makes the mosaic; a reference is named in the project file."));
}

const STEPS = /** @type {Record<string, string>} */ ({
  match: "Tie points are measured in the images", orient: "Images are oriented", mosaic: "The mosaic is drawn", orthos: "An ortho of each image is drawn",
  check: "The mosaic is held against check points and reference", report: "The report is written",
});

/**
 * Steps of the project: fresh, or why not, each with a button that runs it.
 * @param {HTMLElement} panel
 * @param {any[]} steps
 * @param {(step: any) => void} run
 */
export function showSteps(panel, steps, run) {
  const cards = steps.map((step) => element("li", { class: "card" },
    element("div", { class: "head" }, element("span", {}, element("strong", {}, step.name)),
      element("span", { class: `state ${step.fresh ? "good" : "warn"}` }, step.fresh ? "✓ fresh" : "● stale"),
      element("button", { class: "run", "aria-label": `Run ${step.name}${step.fresh ? " again" : ""}`, onclick: () => run(step) }, step.fresh ? "Run again" : "Run")),
    element("small", {}, STEPS[step.name] ?? ""),
    element("p", {}, step.fresh ? `took ${step.seconds.toFixed(1)} s, ended ${new Date(step.finished).toLocaleString()}` : step.reason)));
  panel.replaceChildren(steps.length ? element("ul", { class: "list" }, ...cards) : element("p", { class: "empty" }, "The project file has errors: see Messages."));
}

/**
 * Errors and notes of the project file.
 * @param {HTMLElement} panel
 * @param {any[]} messages
 */
export function showMessages(panel, messages) {
  const cards = messages.map((message) => element("li", { class: `card ${message.kind}` },
    element("p", {}, element("strong", {}, message.kind === "error" ? "Error" : "Note")), element("p", {}, message.what),
    message.where ? element("code", {}, message.where) : null,
    message.hint ? element("p", { class: "faint" }, message.hint) : null));
  panel.replaceChildren(cards.length ? element("ul", { class: "list" }, ...cards) : element("p", { class: "empty" }, "Nothing is wrong with the project file."));
}
