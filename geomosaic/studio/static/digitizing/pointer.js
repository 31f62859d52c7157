// The place under the pointer in the other picture, with its error ellipse.

import { get } from "../api.js";
import { element, shown } from "../dom.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const PAUSE = 70; // milliseconds between two questions
const LEAST = 14; // screen pixels of the larger semi-axis below which an ellipse is drawn enlarged

const line = (/** @type {string} */ color, /** @type {number} */ width) => new ol.style.Stroke({ color, width });
const MARK = ["#10181d", "#00e5ff"].map((colour, i) => new ol.style.Style({ image: new ol.style.RegularShape({ points: 4, radius: 11, radius2: 0, stroke: line(colour, 4 - 2 * i) }) }));
const ELLIPSE = [new ol.style.Style({ stroke: line("rgba(10,20,26,.75)", 4) }), new ol.style.Style({ stroke: line("#00e5ff", 1.8), fill: new ol.style.Fill({ color: "rgba(0,229,255,.12)" }) })];

/** Place under the pointer. */
export class Pointer {
  figures = element("p", { id: "features-place", class: "hint" });

  /** @param {any} tool */
  constructor(tool) {
    this.tool = tool;
    this.busy = false;
    this.side = null; // that is pointed in
    /** @type {(() => void) | null} */
    this.next = null;
    for (const side of [tool.image, tool.map]) {
      side.view.map.on("pointermove", (/** @type {any} */ event) => !event.dragging && this.#ask(side, event.coordinate));
      side.view.canvas.addEventListener("pointerleave", () => { this.side = null; this.clear(); });
    }
  }

  clear() {
    this.next = null;
    for (const side of [this.tool.image, this.tool.map]) {
      side.marks.clear();
      side.view.note.textContent = "";
    }
    this.figures.textContent = "";
  }

  /**
   * One question at a time; of those that come meanwhile the last.
   * @param {any} side
   * @param {number[]} at
   */
  #ask(side, at) {
    const { tool } = this;
    if (!tool.open || !tool.relief || !tool.mapId || !tool.layer) return;
    this.side = side;
    const [first, second] = side.place(at);
    const names = side.name === "image" ? ["col", "row"] : ["x", "y"];
    const pictures = () => ({ image: tool.studio.image?.id, map_layer: tool.mapId });
    const query = String(new URLSearchParams({ ...pictures(), [names[0]]: String(first), [names[1]]: String(second) }));
    const ask = async () => {
      this.busy = true;
      try {
        const found = await get(`/api/features/place?${query}`);
        if (tool.open && this.side === side && query.startsWith(String(new URLSearchParams(pictures())))) this.#show(side, found);
      } catch (error) {
        this.figures.textContent = /** @type {Error} */ (error).message;
      }
      await new Promise((resolve) => setTimeout(resolve, PAUSE));
      this.busy = false;
      const { next } = this;
      this.next = null;
      next?.();
    };
    if (this.busy) this.next = ask;
    else ask();
  }

  /**
   * @param {any} side that was pointed in
   * @param {any} found
   */
  #show(side, found) {
    const { tool } = this;
    this.clear();
    if (!found.xy) {
      this.figures.textContent = "The photo shows no known ground here.";
      return;
    }
    const [col, row] = found.pixel;
    if (side.name === "map") this.#mark(tool.image, new ol.geom.Point([col, -row]), MARK);
    else this.#mark(tool.map, new ol.geom.Point(found.xy), MARK);
    const [major, minor] = found.semi_axes;
    const place = `col ${shown(col, 1)}, row ${shown(row, 1)} is ${found.xy.map((/** @type {number} */ value) => shown(value, tool.map.view.decimals)).join(", ")}, height ${shown(found.z, 1)}`;
    if (major === null || !found.outline) {
      this.figures.textContent = `${place}. ${found.notes.join("; ")}`;
      return;
    }
    const outline = found.outline.map((/** @type {number[]} */ at) => [at[0] - found.xy[0], at[1] - found.xy[1]]);
    const longest = Math.max(...outline.map((/** @type {number[]} */ at) => Math.hypot(at[0], at[1]))) / tool.map.view.map.getView().getResolution();
    const factor = longest >= LEAST ? 1 : [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 10000].find((one) => one * longest >= LEAST) ?? 1;
    this.#mark(tool.map, new ol.geom.Polygon([outline.map((/** @type {number[]} */ at) => [found.xy[0] + factor * at[0], found.xy[1] + factor * at[1]])]), ELLIPSE);
    tool.map.view.note.textContent = factor > 1 ? `error ellipse × ${factor}` : "error ellipse";
    this.figures.textContent = `${place}. Standard ellipse ${shown(major, 2)} × ${shown(minor, 2)} m, azimuth ${shown(found.azimuth, 0)}°${found.sigma_z === null ? "" : `, height ± ${shown(found.sigma_z, 2)} m`}, from ${found.known.join(", ")}${found.adjusted ? "" : "; orientation as declared"}.`;
  }

  /**
   * @param {any} side
   * @param {any} geometry
   * @param {any} style
   */
  #mark(side, geometry, style) {
    const made = new ol.Feature({ geometry });
    made.setStyle(style);
    side.marks.addFeature(made);
  }
}
