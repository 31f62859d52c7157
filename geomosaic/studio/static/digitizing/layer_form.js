// A new layer: its name, kind, CRS and attributes.

import { edit } from "../api.js";
import { element } from "../dom.js";

const KINDS = [["Point", "points"], ["LineString", "lines"], ["Polygon", "areas"]];

/** Form of a new layer. */
export class LayerForm {
  name = /** @type {HTMLInputElement} */ (element("input", { type: "text", id: "new-layer-name", maxlength: 60, required: true }));
  kind = /** @type {HTMLSelectElement} */ (element("select", { id: "new-layer-kind" }, ...KINDS.map(([kind, word]) => element("option", { value: kind }, word))));
  crs = /** @type {HTMLInputElement} */ (element("input", { type: "text", id: "new-layer-crs", placeholder: "that of the map" }));
  fields = element("div", { id: "new-layer-fields" });

  /** @param {any} tool */
  constructor(tool) {
    this.tool = tool;
    this.kind.value = "LineString";
    const form = element("form", { id: "new-layer", onsubmit: (/** @type {Event} */ event) => { event.preventDefault(); this.create(); } },
      element("div", { class: "field" }, element("label", { for: "new-layer-name" }, "Name"), this.name),
      element("div", { class: "field" }, element("label", { for: "new-layer-kind" }, "Of"), this.kind),
      element("div", { class: "field" }, element("label", { for: "new-layer-crs" }, "CRS"), this.crs),
      this.fields,
      element("div", { class: "tools" }, element("button", { type: "button", id: "new-layer-field", onclick: () => this.addField() }, "Add an attribute"), element("button", { class: "primary", id: "new-layer-create" }, "Create the layer")));
    this.details = element("details", { id: "features-new" }, element("summary", {}, "New layer"), form);
  }

  addField() {
    const kinds = this.tool.overview?.kinds ?? ["text"];
    const number = this.fields.childElementCount + 1;
    const row = element("div", { class: "field" }, element("input", { type: "text", "aria-label": `Name of attribute ${number}`, maxlength: 60 }),
      element("select", { "aria-label": `Kind of attribute ${number}` }, ...kinds.map((/** @type {string} */ kind) => element("option", { value: kind }, kind))),
      element("button", { type: "button", class: "icon", "aria-label": `Leave attribute ${number} out`, onclick: () => row.remove() }, "✕"));
    this.fields.append(row);
    row.querySelector("input")?.focus();
  }

  async create() {
    const { tool } = this;
    const fields = [...this.fields.children].map((row) => ({ name: row.querySelector("input")?.value.trim() ?? "", kind: row.querySelector("select")?.value })).filter((one) => one.name);
    await tool.studio.attempt(async () => {
      const name = this.name.value.trim();
      const made = await edit("POST", "/api/features/layers", { name, kind: this.kind.value, crs: this.crs.value, map_layer: tool.mapId, fields });
      tool.wanted = made.id;
      tool.studio.say(`${name}.gpkg created`);
      this.name.value = "";
      this.fields.replaceChildren();
      this.details.removeAttribute("open");
      await tool.load();
      if (tool.layerId === made.id) tool.setMode("draw");
    });
  }
}
