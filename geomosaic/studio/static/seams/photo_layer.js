// One photo over the map as the mosaic would show it: all of it, within the drawn area, or in a lens.

import { get } from "../api.js";
import { tileSource } from "../raster_view.js";
import { circle, clipped } from "./clip.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const LENS = 110; // radius in pixels

/** Layer of the photo that is looked at. */
export class PhotoLayer {
  name = ""; // of the photo that is shown
  serial = 0; // of what is shown; what was asked for before comes too late
  lens = true;
  /** @type {number[] | null} pixel of the pane under the pointer */
  pointer = null;
  /** @type {any} polygon that the photo is shown in */
  area = null;
  /** @type {any} */
  layer = null;

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    this.map = studio.mapView.map;
    this.map.on("pointermove", (/** @type {any} */ event) => {
      this.pointer = event.pixel;
      if (this.layer && this.lens && !this.area) this.layer.changed();
    });
    studio.mapView.canvas.addEventListener("pointerleave", () => { this.pointer = null; this.layer?.changed(); });
  }

  /** @param {string} name of the photo; empty for none */
  async show(name) {
    const serial = ++this.serial;
    this.name = name;
    this.layer?.setMap(null);
    this.layer = null;
    const image = this.studio.project?.images.find((/** @type {any} */ one) => one.name === name);
    const mosaic = this.studio.mapMain;
    if (!image || mosaic?.role !== "mosaic") return;
    const facts = { ...(await get(`/api/raster/${mosaic.id}`)), ready: 1 };
    if (serial !== this.serial) return;
    const { source, extent } = tileSource(mosaic, facts, this.map.getView().getProjection(), mosaic.affine, `/photo-tiles/${image.id}`);
    source.on("tileloaderror", () => this.studio.say(`${name} could not be drawn here`, true));
    const layer = new ol.layer.Tile({ source, extent, zIndex: 20, map: this.map });
    clipped(layer, () => this.#outline(), true);
    this.layer = layer;
  }

  /** Pixels of the pane within which the photo is shown; null for all. */
  #outline() {
    if (this.area) return this.area.getCoordinates()[0].map((/** @type {number[]} */ at) => this.map.getPixelFromCoordinate(at));
    if (!this.lens) return null;
    const size = this.map.getSize();
    return circle(this.pointer ?? [size[0] / 2, size[1] / 2], LENS); // of the keyboard: the middle
  }
}
