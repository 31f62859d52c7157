// Digitizing: layers of GeoPackages drawn on the map and in the image. The server carries vertices between pictures.

import { get, send } from "../api.js";
import { byId, element } from "../dom.js";
import { FeatureForm } from "./form.js";
import { LayerForm } from "./layer_form.js";
import { Pointer } from "./pointer.js";
import { Side, vertices } from "./side.js";
import { FeatureTable } from "./table.js";
import { Waiting } from "./waiting.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const KINDS = /** @type {Record<string, string>} */ ({ POINT: "Point", LINESTRING: "LineString", POLYGON: "Polygon" });
const WORDS = /** @type {Record<string, string>} */ ({ Point: "points", LineString: "lines", Polygon: "areas" });
const HINTS = /** @type {Record<string, string>} */ ({
  choose: "Click a feature to choose it; D draws a new one, V moves vertices.",
  move: "Drag a vertex, or an edge to add one; Alt and a click take a vertex out. By keys, Enter takes hold at the cross and drops. Esc ends.",
  Point: "Click in the map or the image. Esc ends.",
  LineString: "Click vertex by vertex, the last one twice. Esc drops it.",
  Polygon: "Click corner by corner, the last one twice. Esc drops it.",
});

/**
 * Checkbox with a label.
 * @param {string} id
 * @param {string} text
 * @param {string} title
 * @param {() => void} changed
 * @returns {[HTMLInputElement, HTMLElement]}
 */
function option(id, text, title, changed) {
  const box = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", id, onchange: changed }));
  box.checked = true;
  return [box, element("label", { title }, box, text)];
}

/** The tab of digitizing: the layer that is open, what is chosen in it, and what is being drawn. */
export class Digitizing {
  page = Math.random().toString(36).slice(2, 12); // names this page's sketch
  open = false;
  mode = "choose"; // or "draw", "move"
  /** @type {any} */
  overview = null; // of all layers
  /** @type {any} */
  layer = null; // that is open, with its features
  layerId = "";
  /** @type {number | null} */
  selected = null;
  sketching = false;
  savedAt = -Infinity; // when this page changed a file
  serial = 0;
  sending = Promise.resolve();
  reading = Promise.resolve();
  choice = /** @type {HTMLSelectElement} */ (element("select", { id: "features-layer", onchange: () => { this.layerId = this.choice.value; this.selected = null; this.setMode("choose"); this.load(); } }));
  kindChoice = /** @type {HTMLSelectElement} */ (element("select", { id: "features-kind", "aria-label": "Kind of geometry", onchange: () => this.setMode(this.mode) },
    ...Object.entries(WORDS).map(([kind, word]) => element("option", { value: kind }, word))));
  drawButton = element("button", { id: "features-draw", class: "primary", "aria-pressed": "false", onclick: () => this.setMode(this.mode === "draw" ? "choose" : "draw") }, "Draw (D)");
  moveButton = element("button", { id: "features-move", "aria-pressed": "false", onclick: () => this.setMode(this.mode === "move" ? "choose" : "move") }, "Move vertices (V)");
  hint = element("p", { class: "hint", id: "features-hint", "aria-live": "polite" });
  notes = element("ul", { class: "list", id: "features-notes", "aria-label": "Notes on the layer", "aria-live": "polite" });

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    let snap, shared, trace;
    [this.snapBox, snap] = option("features-snap", "Snap", "New vertices go to vertices and edges of the layer that are near", () => this.setMode(this.mode));
    [this.sharedBox, shared] = option("features-shared", "Shared borders", "Vertices that features share move together, and a vertex on a neighbour's edge becomes the neighbour's too", () => this.setMode(this.mode));
    [this.traceBox, trace] = option("features-trace", "Trace", "A click on a neighbour's outline, and one farther along it, take over the outline between them", () => this.setMode(this.mode));
    this.traceBox.checked = false;
    this.image = new Side(this, "image", studio.imageView);
    this.map = new Side(this, "map", studio.mapView);
    this.form = new FeatureForm(this);
    this.table = new FeatureTable(this);
    this.pointer = new Pointer(this);
    this.waiting = new Waiting(this);
    this.layerForm = new LayerForm(this);
    studio.tabs.panel("features").append(
      element("div", { class: "tools" }, element("label", { for: "features-layer" }, "Layer"), this.choice), this.layerForm.details,
      element("div", { class: "tools" }, this.kindChoice, this.drawButton, this.moveButton), this.hint,
      element("div", { class: "tools" }, snap, shared, trace), this.waiting.list, this.notes, this.pointer.figures, this.form.box,
    );
    studio.addEventListener("image", () => this.open && this.load());
    studio.addEventListener("project", () => this.open && this.load());
  }

  /** Keys that the page takes: key, words, act. */
  get keys() {
    return /** @type {[string, string, () => void][]} */ ([
      ["d", "draw: begin, or end", () => this.setMode(this.mode === "draw" ? "choose" : "draw")],
      ["v", "draw: move vertices", () => this.setMode(this.mode === "move" ? "choose" : "move")],
      ["enter", "draw: end the line, or close the area", () => this.#side().draw?.finishDrawing()],
      ["backspace", "draw: take the last vertex back", () => this.#side().draw?.removeLastPoint()],
      ["delete", "draw: delete the chosen feature", () => this.remove()],
      ["escape", "draw: drop what is being drawn, then end drawing", () => this.#leave()],
    ]);
  }

  /** Whether clicks in the pictures draw. */
  get placing() {
    return this.mode === "draw";
  }

  /** Whether a place in a picture is waited for. */
  awaits() {
    return this.open;
  }

  /** Whether what is pressed is held until it is dropped. */
  get holds() {
    return this.mode === "move";
  }

  /** @returns {any} the chosen feature as the server told it */
  get chosen() {
    return this.layer?.features.find((/** @type {any} */ one) => one.id === this.selected);
  }

  /** Whether the image is a raw photo, over whose relief lines run. */
  get relief() {
    return this.studio.project?.images.some((/** @type {any} */ one) => one.id === this.studio.image?.id);
  }

  /** What is drawn in the layer. */
  get kind() {
    const own = this.layer?.kind.replace("MULTI", "") ?? "";
    return KINDS[own] ?? this.kindChoice.value;
  }

  /** @param {boolean} on whether digitizing is what the side shows */
  show(on) {
    if (on === this.open) return;
    this.open = on;
    byId("features-dock").hidden = !on;
    if (on) {
      document.body.dataset.dock = "open";
      this.load();
    } else {
      this.setMode("choose");
      for (const side of [this.image, this.map]) side.clear();
      this.pointer.clear();
    }
    requestAnimationFrame(() => [this.studio.imageView, this.studio.mapView].forEach((view) => view.map.updateSize()));
  }

  /**
   * Undo while drawing takes the last vertex back.
   * @param {string} which
   * @returns {boolean} whether it did
   */
  takeBack(which) {
    if (which !== "undo" || !this.sketching) return false;
    for (const side of [this.image, this.map]) side.draw?.removeLastPoint();
    return true;
  }

  /** Read the layers, and the features of the one that is open, anew; another reading that comes meanwhile is waited for. */
  async load() {
    if (this.sketching) return; // nothing moves under the pen
    const serial = ++this.serial;
    this.reading = this.#read(serial);
    let { reading } = this;
    await reading;
    while (reading !== this.reading) {
      ({ reading } = this);
      await reading;
    }
  }

  /** @param {number} serial */
  async #read(serial) {
    await this.studio.attempt(async () => {
      const overview = await get("/api/features");
      if (serial !== this.serial) return;
      this.overview = overview;
      if (!overview.layers.some((/** @type {any} */ one) => one.id === this.layerId)) this.layerId = overview.layers[0]?.id ?? "";
      this.choice.replaceChildren(...overview.layers.map((/** @type {any} */ one) => element("option", { value: one.id }, one.name === one.file.replace(/\.gpkg$/, "") ? one.file : `${one.file}: ${one.name}`)));
      this.choice.value = this.layerId;
      this.waiting.render();
      this.studio.showHistory(overview.history);
      if (this.layerId) await this.#readLayer(serial);
      else this.layer = null;
      if (serial === this.serial) this.render();
    });
  }

  /** @param {number} serial */
  async #readLayer(serial) {
    const query = new URLSearchParams();
    if (this.mapId) query.set("map_layer", this.mapId);
    if (this.studio.image && !this.studio.image.error) query.set("image", this.studio.image.id);
    try {
      const layer = await get(`/api/features/layers/${this.layerId}?${query}`);
      if (serial === this.serial) this.layer = layer;
    } catch (error) {
      this.layer = null;
      throw error;
    } finally {
      if (!this.layer) this.render();
    }
  }

  /** Raster whose CRS the map has. */
  get mapId() {
    return this.studio.mapMain?.id ?? "";
  }

  /** Show what the server told last. */
  render() {
    const { layer } = this;
    if (!layer?.features.some((/** @type {any} */ one) => one.id === this.selected)) this.selected = null;
    for (const side of [this.image, this.map]) side.show(this.open ? layer?.features ?? [] : []);
    this.kindChoice.hidden = !layer || layer.kind.replace("MULTI", "") in KINDS;
    const words = [...(layer?.fixed ? [`This layer can be looked at, and its attributes changed: ${layer.fixed}.`] : []), ...(layer?.notes ?? []),
      ...(this.overview?.unreadable ?? []).map((/** @type {any} */ one) => `${one.file}: ${one.error}`)];
    this.notes.replaceChildren(...words.map((text) => element("li", { class: "card note" }, element("p", {}, text))));
    for (const button of [this.drawButton, this.moveButton]) button.toggleAttribute("disabled", !layer || Boolean(layer.fixed));
    this.layerForm.details.toggleAttribute("open", this.layerForm.details.hasAttribute("open") || Boolean(this.overview && !this.overview.layers.length));
    this.studio.tabs.count("features", this.overview?.pending.length ? `${this.overview.pending.length} waiting` : "", Boolean(this.overview?.pending.length));
    this.form.render();
    this.table.render();
    if (this.mode !== "draw") this.setMode(this.mode);
  }

  /** @param {string} mode 'choose', 'draw' or 'move' */
  setMode(mode) {
    const able = this.open && this.layer && !this.layer.fixed;
    this.mode = able ? mode : "choose";
    this.sketching = false;
    for (const side of [this.image, this.map]) {
      side.stop();
      if (!side.view.home) continue;
      if (this.mode === "draw") side.startDrawing(this.kind);
      if (this.mode === "move") side.startModifying();
      side.restyle();
    }
    this.drawButton.setAttribute("aria-pressed", String(this.mode === "draw"));
    this.moveButton.setAttribute("aria-pressed", String(this.mode === "move"));
    this.hint.textContent = !this.open ? "" : !this.layer ? "" : HINTS[this.mode === "draw" ? this.kind : this.mode];
    for (const side of [this.image, this.map]) side.view.cursor?.show();
  }

  /** The picture that has the focus, or is alone, or where something is being drawn. */
  #side() {
    const drawing = [this.image, this.map].find((side) => side.sketched.length);
    const shown = byId("views").dataset.view;
    return drawing ?? (shown === "image" || (shown !== "map" && document.activeElement === this.studio.imageView.canvas) ? this.image : this.map);
  }

  #leave() {
    if (this.sketching) {
      for (const side of [this.image, this.map]) side.draw?.abortDrawing();
      this.dropSketch();
    } else this.setMode("choose");
  }

  /**
   * Keep what is being drawn, vertex by vertex: the server has it on its disk before it answers.
   * @param {Side} side
   * @param {string} kind
   * @param {number[][]} places
   */
  keepSketch(side, kind, places) {
    this.sketching = true;
    const drawn = { layer: this.layerId, side: side.name, picture: side.name === "image" ? this.studio.image.id : this.mapId, kind, coordinates: places };
    if (places.length) this.#sendSketch(drawn);
  }

  dropSketch() {
    this.sketching = false;
    this.#sendSketch(null);
  }

  /** @param {any} drawn in the order in which it was drawn */
  #sendSketch(drawn) {
    this.sending = this.sending.then(async () => { await this.studio.attempt(() => send("PUT", "/api/features/sketch", { page: this.page, drawn })); });
  }

  /**
   * Go on with what was being drawn before.
   * @param {string} key of the sketch
   * @param {any} drawn
   */
  async resume(key, drawn) {
    this.layerId = drawn.layer;
    await this.load();
    if (drawn.side === "image" && this.studio.image?.id !== drawn.picture) {
      const image = [...this.studio.project.images, ...this.studio.project.layers].find((/** @type {any} */ one) => one.id === drawn.picture);
      if (!image) return this.studio.say("the image that was drawn in is gone", true);
      await this.studio.chooseImage(image);
      await this.load();
    }
    this.setMode("draw");
    this[/** @type {"image" | "map"} */ (drawn.side)].extend(drawn.coordinates);
    if (key !== this.page) await send("PUT", "/api/features/sketch", { page: key, drawn: null });
    this.overview.sketches = {};
    this.waiting.render();
    this.studio.say("go on with the next vertex");
    return undefined;
  }

  /**
   * Save what was drawn; where that fails the drawing stays.
   * @param {Side} side
   * @param {string} kind
   * @param {any} geometry
   */
  async finish(side, kind, geometry) {
    this.sketching = false;
    const places = kind === "Polygon" ? geometry.getCoordinates()[0].slice(0, -1) : kind === "LineString" ? geometry.getCoordinates() : [];
    await this.sending;
    const made = await this.studio.attempt(() => this.#edit(side, [{ id: null, geometry: side.write(geometry) }]));
    if (made) {
      this.selected = made.ids[0];
      await this.load();
      this.form.focus();
    } else if (places.length) {
      if (this.mode !== "draw") this.setMode("draw");
      side.extend(places.map((/** @type {number[]} */ at) => side.place(at)));
    }
  }

  /**
   * Save the features that were moved.
   * @param {Side} side
   */
  async reshape(side) {
    const known = new Map(this.layer.features.map((/** @type {any} */ one) => [one.id, one]));
    const changes = side.source.getFeatures().flatMap((/** @type {any} */ one) => {
      const before = known.get(one.getId());
      const same = before && JSON.stringify(vertices(one.getGeometry())) === JSON.stringify(vertices(side.read(before[side.name])));
      return same ? [] : [{ id: one.getId(), stamp: one.get("stamp"), geometry: side.write(one.getGeometry()) }];
    });
    if (changes.length) await this.studio.attempt(() => this.#edit(side, changes));
    await this.load();
  }

  /**
   * Change attributes of the chosen feature.
   * @param {Record<string, any>} values
   */
  async setValues(values) {
    const { chosen } = this;
    if (!chosen) return;
    await this.studio.attempt(() => this.#edit(this.map, [{ id: chosen.id, stamp: chosen.stamp, values }]));
    await this.load();
  }

  /** Delete the chosen feature. */
  async remove() {
    const { chosen } = this;
    if (!chosen) return this.studio.say("choose a feature first", true);
    await this.studio.attempt(() => this.#edit(this.map, [{ id: chosen.id, stamp: chosen.stamp, remove: true }]));
    return this.load();
  }

  /**
   * @param {Side} side whose coordinates the changes have
   * @param {any[]} changes
   */
  async #edit(side, changes) {
    this.savedAt = performance.now();
    const where = side.name === "image" ? { image: this.studio.image.id } : { map_layer: this.mapId };
    const made = await send("POST", `/api/features/layers/${this.layerId}/edits`, { changes, ...where, shared: this.sharedBox.checked, page: this.page });
    this.studio.say([made.title, ...made.notes].join("; "), made.notes.length > 0);
    return made;
  }

  /**
   * @param {number | null} id
   * @param {boolean} centre whether the pictures go to it
   */
  choose(id, centre) {
    this.selected = id;
    if (centre) for (const side of [this.image, this.map]) {
      const geometry = side.source.getFeatureById(id)?.getGeometry();
      if (geometry && !ol.extent.containsExtent(side.view.map.getView().calculateExtent(), geometry.getExtent())) side.view.map.getView().fit(geometry.getExtent(), { padding: [60, 60, 60, 60], maxZoom: side.view.map.getView().getZoom() });
    }
    this.form.render();
    this.table.mark();
    if (this.mode === "move") this.setMode("move");
    for (const side of [this.image, this.map]) side.restyle();
  }
}
