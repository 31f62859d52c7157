// Digitizing: layers of GeoPackages drawn on the map and in the image. The server carries vertices between pictures.

import { editsMade, get } from "../api.js";
import { byId, element, firstThere } from "../dom.js";
import { Edits } from "./edits.js";
import { FeatureForm } from "./form.js";
import { LayerForm } from "./layer_form.js";
import { Pointer } from "./pointer.js";
import { Side } from "./side.js";
import { Sketch } from "./sketch.js";
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

/**
 * Features with what the image shows of them, as far as that is known of their present state.
 * @param {any[]} features
 * @param {any[]} known
 */
function inImage(features, known) {
  const before = new Map(known.map((one) => [one.id, one]));
  return features.map((one) => {
    const own = before.get(one.id);
    return own?.stamp === one.stamp ? { ...one, image: own.image, drawn: own.drawn } : one;
  });
}

/** The tab of digitizing: the layer that is open, what is chosen in it, and what is being drawn. */
export class Digitizing {
  open = false;
  mode = "choose"; // or "draw", "move"
  /** @type {any} */
  overview = null; // of all layers
  /** @type {any} */
  layer = null; // that is open, with its features
  layerId = "";
  imageId = ""; // of the image that was open last
  wanted = ""; // id of the layer that was chosen last; a file that is being written may be missing for a moment
  /** @type {number | null} */
  selected = null;
  serial = 0;
  reading = Promise.resolve();
  choice = /** @type {HTMLSelectElement} */ (element("select", { id: "features-layer", onchange: () => { this.wanted = this.choice.value; this.#close(); this.load(); } }));
  kindChoice = /** @type {HTMLSelectElement} */ (element("select", { id: "features-kind", "aria-label": "Kind of geometry", onchange: () => this.setMode(this.mode) },
    ...Object.entries(WORDS).map(([kind, word]) => element("option", { value: kind }, word))));
  drawButton = element("button", { id: "features-draw", class: "primary", "aria-pressed": "false", onclick: () => this.setMode(this.mode === "draw" ? "choose" : "draw") }, "Draw (D)");
  moveButton = element("button", { id: "features-move", "aria-pressed": "false", onclick: () => this.setMode(this.mode === "move" ? "choose" : "move") }, "Move vertices (V)");
  hint = element("p", { class: "hint", id: "features-hint", "aria-live": "polite" });
  notes = element("ul", { class: "list", id: "features-notes", "aria-label": "Notes on the layer", "aria-live": "polite" });

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    const [snapBox, snap] = option("features-snap", "Snap", "New vertices go to vertices and edges of the layer that are near", () => this.#again());
    const [sharedBox, shared] = option("features-shared", "Shared borders", "Vertices that features share move together, and a vertex on a neighbour's edge becomes the neighbour's too", () => this.#again());
    const [traceBox, trace] = option("features-trace", "Trace", "A click on a neighbour's outline, and one farther along it, take over the outline between them", () => this.#again());
    traceBox.checked = false;
    this.snapBox = snapBox;
    this.sharedBox = sharedBox;
    this.traceBox = traceBox;
    this.image = new Side(this, "image", studio.imageView);
    this.map = new Side(this, "map", studio.mapView);
    this.sketch = new Sketch(this);
    this.edits = new Edits(this);
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
    studio.addEventListener("image", () => this.open && this.#openImage());
    studio.addEventListener("map", () => this.open && this.#takePicture());
    studio.addEventListener("crs", () => this.open && this.#leaveMap());
    studio.addEventListener("project", () => this.open && this.load());
    studio.addEventListener("takenback", () => this.edits.forget());
    studio.addEventListener("waiting", () => this.open && this.load());
  }

  /** Keys that the page takes: key, words, act. */
  get keys() {
    return /** @type {[string, string, () => void][]} */ ([
      ["d", "begin, or end", () => this.setMode(this.mode === "draw" ? "choose" : "draw")],
      ["v", "move vertices", () => this.setMode(this.mode === "move" ? "choose" : "move")],
      ["enter", "end the line, or close the area", () => this.#side().draw?.finishDrawing()],
      ["backspace", "take the last vertex back", () => this.sketch.takeBack()],
      ["delete", "delete the chosen feature", () => this.edits.remove()],
      ["escape", "drop what is being drawn, then end drawing", () => this.#leave()],
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
    this.imageId = this.studio.image?.id ?? "";
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
    if (which !== "undo" || !this.sketch.going) return false;
    this.sketch.takeBack();
    return true;
  }

  /** Show the features in the image that was opened; what was being drawn in the one before waits to be gone on with there. */
  #openImage() {
    const id = this.studio.image?.id ?? "";
    if (id !== this.imageId) {
      this.serial += 1;
      if (this.image.sketched.length || !this.sketch.going) this.setMode(this.mode);
      this.image.clear();
    }
    this.imageId = id;
    this.load();
  }

  /** Go on with what the pointer does in a picture that was not there yet when that began. */
  #takePicture() {
    if (this.mode !== "choose" && !this.sketch.going && [this.image, this.map].some((side) => side.view.home && !side.interactions.length)) this.setMode(this.mode);
  }

  /** Leave what was begun on the map, whose places are in another CRS now; the project is being read, and with it the layer. */
  #leaveMap() {
    this.serial += 1;
    this.setMode("choose");
    this.map.clear();
  }

  /** Show no layer, until the one that was chosen is read. */
  #close() {
    this.selected = null;
    this.setMode("choose");
    this.layer = null;
    this.render();
  }

  /** Whether a vertex is held. */
  get dragging() {
    return [this.image, this.map].some((side) => side.modify?.handlingDownUpSequence);
  }

  /** Read the layers, and the features of the one that is open, anew; another reading that comes meanwhile is waited for. */
  async load() {
    if (this.sketch.going) return; // nothing moves under the pen
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
      await editsMade();
      const overview = await get("/api/features");
      while (this.dragging) await new Promise((resolve) => requestAnimationFrame(resolve));
      if (serial !== this.serial) return;
      this.overview = overview;
      const id = firstThere([this.wanted, this.layerId], overview.layers);
      if (id !== this.layerId) this.#close();
      this.layerId = id;
      this.choice.replaceChildren(...overview.layers.map((/** @type {any} */ one) => element("option", { value: one.id }, one.name === one.file.replace(/\.gpkg$/, "") ? one.file : `${one.file}: ${one.name}`)));
      this.choice.value = this.layerId;
      this.waiting.render();
      this.studio.showHistory(overview.history);
      if (this.layerId) await this.#readLayer(serial);
      else this.layer = null;
      if (serial === this.serial && !this.layer?.image) this.render();
    });
  }

  /**
   * Read the features on the map and show them; then those in the image, which take longer where a photo has relief.
   * @param {number} serial
   */
  async #readLayer(serial) {
    const { studio } = this, address = `/api/features/layers/${this.layerId}`;
    const image = studio.image && !studio.image.error ? studio.image.id : "";
    const { canvas } = studio.imageView;
    canvas.setAttribute("aria-busy", "true");
    try {
      const layer = await get(`${address}${this.mapId ? `?map_layer=${this.mapId}` : ""}`);
      while (this.dragging) await new Promise((resolve) => requestAnimationFrame(resolve));
      if (serial !== this.serial) return;
      const before = this.layer?.id === layer.id && this.layer.image === image ? this.layer.features : [];
      this.layer = { ...layer, image, features: inImage(layer.features, before) };
      this.edits.forget();
      if (!image) return;
      this.render();
      const found = await get(`${address}?image=${image}`);
      while (this.dragging) await new Promise((resolve) => requestAnimationFrame(resolve));
      if (serial !== this.serial) return;
      this.layer = { ...this.layer, features: inImage(layer.features, found.features), notes: [...layer.notes, ...found.notes] };
      this.image.show(this.open ? this.layer.features : []);
      if (this.mode === "move") this.image.startModifying();
      this.#renderNotes();
    } catch (error) {
      if (serial !== this.serial) return;
      this.layer = null;
      this.render();
      throw error;
    } finally {
      if (serial === this.serial) canvas.setAttribute("aria-busy", "false");
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
    this.#renderNotes();
    for (const button of [this.drawButton, this.moveButton]) button.toggleAttribute("disabled", !layer || Boolean(layer.fixed));
    this.layerForm.details.toggleAttribute("open", this.layerForm.details.hasAttribute("open") || Boolean(this.overview && !this.overview.layers.length));
    this.studio.tabs.count("features", this.overview?.pending.length ? `${this.overview.pending.length} waiting` : "", Boolean(this.overview?.pending.length));
    this.form.render();
    this.table.render();
    if (this.mode !== "draw") this.setMode(this.mode);
  }

  #renderNotes() {
    const { layer } = this;
    const words = [...(layer?.fixed ? [`This layer can be looked at, and its attributes changed: ${layer.fixed}.`] : []), ...(layer?.notes ?? []),
      ...(this.overview?.unreadable ?? []).map((/** @type {any} */ one) => `${one.file}: ${one.error}`)];
    this.notes.replaceChildren(...words.map((text) => element("li", { class: "card note" }, element("p", {}, text))));
  }

  /** @param {string} mode 'choose', 'draw' or 'move' */
  setMode(mode) {
    const able = this.open && this.layer && !this.layer.fixed;
    if (this.open && !this.layer && mode !== "choose") this.studio.say(this.overview && !this.overview.layers.length ? "create a layer first" : "the layer is still being read", true);
    const left = this.sketch.going; // what was drawn stays to be gone on with
    this.mode = able ? mode : "choose";
    if (left) this.sketch.leave();
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
    if (left && this.open) this.sketch.sending.then(() => this.load());
  }

  /** Take over an option that was changed; what is being drawn goes on. */
  #again() {
    const side = this.#side();
    const places = this.sketch.going ? side.sketched : [];
    this.sketch.going &&= !places.length;
    this.setMode(this.mode);
    if (places.length) side.extend(places);
  }

  /** The picture that has the focus, or is alone, or where something is being drawn. */
  #side() {
    const drawing = [this.image, this.map].find((side) => side.sketched.length);
    const shown = byId("views").dataset.view;
    return drawing ?? (shown === "image" || (shown !== "map" && document.activeElement === this.studio.imageView.canvas) ? this.image : this.map);
  }

  /** Drop what is being drawn, else end drawing or moving. */
  #leave() {
    if (!this.sketch.going) return this.setMode("choose");
    for (const side of [this.image, this.map]) side.draw?.abortDrawing();
    if (this.sketch.going) this.sketch.drop();
    return undefined;
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
