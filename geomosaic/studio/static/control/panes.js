// The two panes of control: how their places go together, and pictures that follow each other.

import { get } from "../api.js";
import { Drawings } from "../drawings.js";

/** Image and map beside each other. Places of the image are col and row, of the map its coordinates. */
export class Panes {
  /** @param {any} control */
  constructor(control) {
    this.control = control;
    this.studio = control.studio;
    this.following = false;
    this.serial = 0; // of the place that the other picture goes to
    this.active = "image"; // the pane that was pointed at last, or has the focus
    this.image = new Drawings(this.studio.imageView.map);
    this.map = new Drawings(this.studio.mapView.map);
    for (const side of /** @type {("image" | "map")[]} */ (["image", "map"])) {
      const view = this.view(side);
      view.map.on("moveend", () => this.following && this.active === side && this.#lead(side));
      view.canvas.addEventListener("pointerenter", () => { this.active = side; });
      view.canvas.addEventListener("focus", () => { this.active = side; });
    }
  }

  /** @param {string} side */
  view(side) {
    return side === "image" ? this.studio.imageView : this.studio.mapView;
  }

  clear() {
    this.image.clear();
    this.map.clear();
  }

  /** @returns {any} layer of the map that points are taken from */
  get layer() {
    const drawn = this.studio.entries.filter((/** @type {any} */ one) => one.drawn && one.layer.affine && one.layer.map_crs === this.studio.mapMain?.map_crs);
    const visible = drawn.filter((/** @type {any} */ one) => one.drawn.getVisible());
    return (visible.find((/** @type {any} */ one) => one.layer.role === "reference") ?? visible[0] ?? drawn[0])?.layer ?? null;
  }

  /** @param {number[]} at map coordinates of a place, as the server takes it */
  onLayer(at) {
    if (!this.layer) throw new Error("the map shows no raster yet from which a place can be taken");
    const [mapCol, mapRow] = this.layerPixel(at);
    return { layer: this.layer.id, map_col: mapCol, map_row: mapRow };
  }

  /** @param {number[]} at map coordinates */
  layerPixel(at) {
    const [a, , c, , e, f] = this.layer.affine;
    return [(at[0] - c) / a, (at[1] - f) / e];
  }

  /**
   * @param {number[]} pixel
   * @param {any} layer
   */
  mapPlace(pixel, layer) {
    const [a, , c, , e, f] = layer.affine;
    return [c + a * pixel[0], f + e * pixel[1]];
  }

  /**
   * Where a place of one side is expected on the other; null where nothing tells.
   * @param {string} side
   * @param {number[]} at
   */
  async expected(side, at) {
    const { layer } = this; // another one may be shown once this is answered
    if (!layer || !this.control.state?.predicts) return null;
    const query = this.control.query();
    const pixel = side === "map" ? this.layerPixel(at) : at;
    query.set(side === "map" ? "map_col" : "col", String(pixel[0]));
    query.set(side === "map" ? "map_row" : "row", String(pixel[1]));
    const found = await get(`/api/control/${this.studio.image.id}/expected?${query}`);
    if (found.col === null) return null;
    return side === "map" ? [found.col, found.row] : this.mapPlace([found.col, found.row], layer);
  }

  /**
   * @param {string} side
   * @param {number[]} at
   * @param {boolean} [near] at least at the raster's own scale
   */
  centre(side, at, near = false) {
    const view = this.view(side);
    if (!view.home || (side === "map" && !this.layer)) return;
    const pixel = side === "image" ? 1 : this.layer.affine[0];
    const here = view.map.getView();
    const place = side === "image" ? [at[0], -at[1]] : at;
    const [left, bottom, right, top] = here.calculateExtent();
    const inside = Math.abs(place[0] - (left + right) / 2) < 0.4 * (right - left) && Math.abs(place[1] - (bottom + top) / 2) < 0.4 * (top - bottom);
    if (inside && !near) return; // a picture that shows the place stays as it is
    here.setCenter(place);
    if (near && here.getResolution() > pixel) here.setResolution(pixel);
  }

  /**
   * Point of the control drawings at a pixel of the screen; null where there is none.
   * @param {string} side
   * @param {number[]} pixel
   * @returns {string | null}
   */
  pointAt(side, pixel) {
    const drawings = side === "image" ? this.image : this.map;
    let found = /** @type {string | null} */ (null);
    this.view(side).map.forEachFeatureAtPixel(pixel, (/** @type {any} */ feature) => { found ??= feature.get("point") ?? null; }, { hitTolerance: 6, layerFilter: (/** @type {any} */ one) => one === drawings.layer });
    return found;
  }

  /** @param {boolean} on */
  follow(on) {
    this.following = on;
    if (on) this.#lead(this.active);
  }

  /** @param {string} side that leads */
  async #lead(side) {
    const [lead, other] = side === "image" ? [this.studio.imageView, this.studio.mapView] : [this.studio.mapView, this.studio.imageView];
    if (!this.control.open || !lead.home || !other.home) return;
    const [x, y] = lead.map.getView().getCenter();
    const serial = ++this.serial;
    await this.studio.attempt(async () => {
      const found = await this.expected(side, side === "image" ? [x, -y] : [x, y]);
      if (found && serial === this.serial) other.map.getView().setCenter(side === "image" ? found : [found[0], -found[1]]);
    });
  }
}
