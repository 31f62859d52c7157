// Views of rasters: an image in its own pixels, or layers of the map in their common CRS.

import { get } from "./api.js";
import { element, shown } from "./dom.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

/**
 * Source of the tiles of a raster, in its pixels (x = column, y = -row) or in the map.
 * @param {any} layer of /api/project
 * @param {any} facts of /api/raster
 * @param {any} projection
 * @param {number[] | null} affine pixel corners to the map; null for pixels
 * @param {string} [address] of the tiles
 */
export function tileSource(layer, facts, projection, affine, address = `/tiles/${layer.id}`) {
  const [pixel, left, top] = affine ? [affine[0], affine[2], affine[5]] : [1, 0, 0];
  const resolutions = Array.from({ length: facts.levels }, (_, z) => pixel * 2 ** (facts.levels - 1 - z));
  const extent = [left, top - facts.height * pixel, left + facts.width * pixel, top];
  const tileGrid = new ol.tilegrid.TileGrid({ extent, origin: [left, top], resolutions, tileSize: facts.tile });
  let drawn = 0; // counts up while the coarse view of a raster grows
  // A tile is as old as the last version in which one of its pixels changed: the browser keeps it until then.
  let versions = [{ version: facts.version, windows: /** @type {number[][] | null} */ (null) }];
  const versionAt = (/** @type {number[]} */ [z, x, y]) => {
    const side = facts.tile * 2 ** (facts.levels - 1 - z);
    const meets = (/** @type {number[]} */ one) => one[0] < (x + 1) * side && one[2] > x * side && one[1] < (y + 1) * side && one[3] > y * side;
    return versions.findLast((one) => !one.windows || one.windows.some(meets))?.version;
  };
  const tileUrlFunction = (/** @type {number[]} */ at) => at && `${address}/${at[0]}/${at[1]}/${at[2]}.webp?${facts.ready < 1 ? `n=${drawn}` : `v=${versionAt(at)}`}`;
  const source = new ol.source.TileImage({ projection, tileGrid, wrapX: false, transition: 0, tileUrlFunction });
  const renew = async (/** @type {number[][] | null} */ windows) => {
    const stretch = JSON.stringify(facts.stretch);
    Object.assign(facts, await get(`/api/raster/${layer.id}`));
    const known = windows && JSON.stringify(facts.stretch) === stretch;
    versions = [...(known ? versions : []), { version: facts.version, windows: known ? windows : null }];
    source.setTileUrlFunction(tileUrlFunction, facts.version); // what was drawn stays until the new tiles are there
  };
  return { source, extent, renew, again: () => { drawn += 1; source.refresh(); } };
}

/** Pane with a raster or several, its caption and its place under the pointer. */
export class RasterView {
  /**
   * @param {HTMLElement} section
   * @param {(text: string, bad?: boolean) => void} say
   */
  constructor(section, say) {
    this.section = section;
    this.say = say;
    this.canvas = /** @type {HTMLElement} */ (section.querySelector(".canvas"));
    this.caption = /** @type {HTMLElement} */ (section.querySelector(".name"));
    this.note = /** @type {HTMLElement} */ (section.querySelector(".note"));
    this.place = /** @type {HTMLElement} */ (section.querySelector(".place"));
    this.overlay = element("div", { class: "overlay" });
    this.canvas.append(this.overlay);
    this.decimals = 1;
    this.pixels = false; // whether places are columns and rows
    this.serial = 0; // of what is shown; what was asked for before comes too late
    this.home = /** @type {number[] | null} */ (null);
    /** @type {any} */
    this.cursor = null; // of the keyboard
    this.whole = /** @type {number | undefined} */ (undefined); // resolution that shows all
    const scale = new ol.control.ScaleLine({ minWidth: 90 });
    this.scale = scale;
    this.map = new ol.Map({
      target: this.canvas, layers: [], keyboardEventTarget: this.canvas, pixelRatio: Math.min(2, devicePixelRatio || 1),
      controls: [new ol.control.Zoom({ zoomInTipLabel: "Zoom in (+)", zoomOutTipLabel: "Zoom out (-)" })],
      interactions: ol.interaction.defaults.defaults({ altShiftDragRotate: false, pinchRotate: false, zoomDuration: 120 }),
    });
    Object.assign(this.canvas, { view: this }); // for scripts from outside: where a place lies on the screen
    this.map.on("pointermove", (/** @type {any} */ event) => this.tellPlace(event.coordinate));
    // A picture that was shown whole stays whole in a pane of another size.
    this.map.on("change:size", () => { if (this.home && this.map.getView().getResolution() === this.whole) this.fit(0); });
    this.canvas.addEventListener("pointerleave", () => { this.place.textContent = ""; });
  }

  /** @param {string} text nothing but this is shown */
  empty(text) {
    this.serial += 1;
    this.map.setLayers([]);
    this.map.removeControl(this.scale);
    this.caption.textContent = text;
    this.overlay.textContent = text;
    this.home = null;
  }

  /**
   * Show one raster in its own pixels.
   * @param {any} layer of /api/project
   * @returns {Promise<boolean>} whether it is shown; something else may have been asked for meanwhile
   */
  async showImage(layer) {
    const serial = ++this.serial;
    const facts = await get(`/api/raster/${layer.id}`);
    if (serial !== this.serial) return false;
    this.pixels = true;
    this.decimals = 1;
    const extent = [0, -facts.height, facts.width, 0];
    const projection = new ol.proj.Projection({ code: `pixels-${layer.id}`, units: "pixels", extent });
    const tiles = tileSource(layer, facts, projection, null);
    this.map.setLayers([new ol.layer.Tile({ source: tiles.source, extent })]);
    this.map.removeControl(this.scale);
    this.caption.textContent = layer.name;
    this.overlay.textContent = "";
    this.#setView(projection, extent, 1);
    this.#watch(layer, facts, tiles, serial);
    return true;
  }

  /**
   * Start a map in a CRS, over an extent.
   * @param {any} layer whose CRS and extent it takes
   * @param {string} title
   */
  startMap(layer, title) {
    this.serial += 1;
    this.pixels = false;
    const [a, , c, , e, f] = layer.affine;
    const extent = [c, f + e * layer.height, c + a * layer.width, f];
    const degrees = layer.geographic;
    this.decimals = degrees ? 7 : a < 0.5 ? 2 : 1;
    const projection = new ol.proj.Projection({
      code: `map-${layer.id}`, units: degrees ? "degrees" : "m", metersPerUnit: layer.metres_per_unit,
      getPointResolution: (/** @type {number} */ resolution) => resolution * layer.metres_per_unit,
    });
    this.map.setLayers([]);
    this.map.removeControl(this.scale);
    if (!degrees) this.map.addControl(this.scale);
    this.caption.textContent = title;
    this.overlay.textContent = "";
    this.#setView(projection, extent, a);
    return projection;
  }

  /**
   * Layer of tiles for the map that was started.
   * @param {any} layer of /api/project
   * @param {any} projection
   */
  async mapLayer(layer, projection) {
    const serial = this.serial;
    const facts = await get(`/api/raster/${layer.id}`);
    const tiles = tileSource(layer, facts, projection, layer.affine);
    this.#watch(layer, facts, tiles, serial);
    const drawn = new ol.layer.Tile({ source: tiles.source, extent: tiles.extent });
    drawn.set("renew", tiles.renew); // takes windows of pixels that changed, null for all
    return drawn;
  }

  /**
   * Show all of what there is.
   * @param {number} [duration] milliseconds
   */
  fit(duration = 120) {
    if (!this.home || !this.map.getSize()?.[0]) return;
    const view = this.map.getView();
    view.fit(this.home, { padding: [12, 12, 12, 12], duration, callback: () => { this.whole = view.getResolution(); } });
  }

  /**
   * @param {any} projection
   * @param {number[]} extent
   * @param {number} pixel
   */
  #setView(projection, extent, pixel) {
    this.home = extent;
    this.map.updateSize();
    const view = new ol.View({
      projection, center: ol.extent.getCenter(extent), minResolution: pixel / 32, showFullExtent: true,
      maxResolution: 4 * Math.max(extent[2] - extent[0], extent[3] - extent[1]) / 256, enableRotation: false,
      resolution: pixel,
    });
    this.map.setView(view);
    this.whole = view.getResolution(); // until the pane has a size
    this.fit(0);
  }

  /**
   * Tell what fails, and draw again as the coarse view of a raster grows.
   * @param {any} layer
   * @param {any} facts
   * @param {any} tiles
   * @param {number} serial
   */
  #watch(layer, facts, tiles, serial) {
    let told = false;
    tiles.source.on("tileloaderror", async () => {
      if (told) return;
      told = true;
      try {
        await get(`/api/raster/${layer.id}`);
        this.say(`a part of ${layer.name} could not be read`, true);
      } catch (error) {
        this.say(`${layer.name}: ${/** @type {Error} */ (error).message}`, true);
      }
    });
    const progress = async () => {
      if (serial !== this.serial) return;
      this.note.textContent = facts.ready < 1 ? `reading ${Math.floor(100 * facts.ready)} %` : "";
      if (facts.ready >= 1) return;
      await new Promise((resolve) => setTimeout(resolve, 700));
      try {
        Object.assign(facts, await get(`/api/raster/${layer.id}`));
      } catch {
        return; // the tiles tell why
      }
      tiles.again();
      progress();
    };
    progress();
  }

  /**
   * Place on the screen of col and row, or x and y, once the view rests.
   * @param {number[]} place
   */
  async onScreen([x, y]) {
    const frame = () => new Promise((resolve) => requestAnimationFrame(resolve));
    const state = () => JSON.stringify([this.map.getSize(), this.map.getView().getCenter(), this.map.getView().getResolution()]);
    for (let before = ""; before !== state() || this.map.getView().getAnimating() || !this.home; ) {
      before = state();
      await frame();
      await frame();
    }
    this.map.renderSync();
    const { left, top } = this.map.getViewport().getBoundingClientRect();
    const [column, row] = this.map.getPixelFromCoordinate([x, this.pixels ? -y : y]);
    return [left + column, top + row];
  }

  /** @param {number[]} coordinate that the caption tells */
  tellPlace(coordinate) {
    if (!this.home) return;
    const [x, y] = coordinate;
    const [first, second] = this.pixels ? ["col", "row"] : ["x", "y"];
    this.place.textContent = `${first} ${shown(x, this.decimals)}   ${second} ${shown(this.pixels ? -y : y, this.decimals)}`;
  }
}
