// Seams: moved, redrawn and cut on the map, areas given to other photos, colours of one photo. The server edits the file
// of seams that the command line reads, and the mosaic is made anew where an edit touches it.

import { edit, get, send } from "../api.js";
import { element, shown } from "../dom.js";
import { ColourForm } from "./colour_form.js";
import { PhotoLayer } from "./photo_layer.js";
import { SeamLines } from "./seam_lines.js";
import { Swipe } from "./swipe.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const MODES = /** @type {[string, string, string, string][]} */ ([
  ["look", "Look", "L", "Click a place to list the photos that show it."],
  ["drag", "Drag", "D", "Drag a seam; the photo from whose side it is dragged gets what it sweeps over. Farther drags move more of it. By keys, Enter takes the seam at the cross and drops it."],
  ["redraw", "Redraw", "R", "Draw the new seam from the old one back to it, or to another; what it cuts off goes to the photo across the seam where it begins. The last click, or Enter, twice."],
  ["area", "Area", "A", "Draw an area, the last corner twice, then give it to a photo of the list."],
  ["cut", "Cut", "X", "Draw a line across one photo's part, the last click twice, and choose a piece."],
]);
const KINDS = /** @type {Record<string, string>} */ ({ redraw: "LineString", cut: "LineString", area: "Polygon" });

/** The tab of seams. */
export class Seams {
  open = false;
  mode = "look";
  serial = 0;
  /** @type {any} */
  state = null;
  /** @type {any} polygon that is to be given */
  area = null;
  /** @type {any} */
  draw = null; // OpenLayers' interaction
  /** @type {{at: number[], line: number[][]} | null} */
  taken = null;
  /** @type {any[]} */
  found = []; // photos of the place or the area
  asked = 0; // of the place, area or line that was asked about last
  title = "";
  footprintsShown = false; // before this tab was opened
  buttons = new Map(MODES.map(([mode, title, key]) => [mode, element("button", { id: `seams-${mode}`, "aria-pressed": "false", onclick: () => this.setMode(mode) }, `${title} (${key})`)]));
  file = element("p", { class: "hint", id: "seams-file" });
  reason = element("span");
  stale = element("p", { class: "warn", id: "seams-stale", hidden: true }, this.reason, " ", element("button", { onclick: () => this.#edit("run", {}, "") }, "Make it anew"));
  hint = element("p", { class: "hint", id: "seams-hint", "aria-live": "polite" });
  list = element("div", { id: "seams-photos", "aria-live": "polite" });
  lensBox = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", id: "seams-lens", onchange: () => this.#lens(this.lensBox.checked) }));

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    this.view = studio.mapView;
    this.lines = new SeamLines(this.view.map);
    this.photo = new PhotoLayer(studio);
    this.swipe = new Swipe(studio);
    this.colours = new ColourForm(this);
    this.lensBox.checked = true;
    studio.tabs.panel("seams").append(
      this.file, this.stale, element("div", { class: "tools", role: "group", "aria-label": "What the pointer does" }, ...this.buttons.values()), this.hint, this.list,
      element("div", { class: "tools" }, element("label", { title: "The photo that is looked at shows round the pointer only" }, this.lensBox, "Lens"), this.swipe.button), this.colours.box,
    );
    this.pointer = new ol.interaction.Pointer({
      handleDownEvent: (/** @type {any} */ event) => this.#take(event),
      handleDragEvent: (/** @type {any} */ event) => this.taken && this.lines.preview(this.taken, event.coordinate),
      handleUpEvent: (/** @type {any} */ event) => { this.#drop(event.coordinate); return false; },
      handleMoveEvent: (/** @type {any} */ event) => this.view.canvas.classList.toggle("taking", this.mode === "drag" && Boolean(this.lines.near(event.coordinate))),
    });
    this.view.map.on("click", (/** @type {any} */ event) => this.#click(event));
    studio.addEventListener("project", () => this.open && this.load());
    studio.addEventListener("map", () => this.open && this.#footprints(true));
    studio.addEventListener("crs", () => this.open && this.setMode("look"));
    studio.addEventListener("steps", () => this.#showStale());
    studio.addEventListener("takenback", () => this.open && this.#edit("run", {}, ""));
  }

  /** Say where the mosaic is older than the seams, or than anything else that it is made of. */
  #showStale() {
    const step = this.studio.steps?.find((/** @type {any} */ one) => one.name === "mosaic");
    this.stale.hidden = !step || step.fresh || Boolean(this.state?.reason) || ["running", "stopping"].includes(this.studio.runs.state);
    this.reason.textContent = step && !step.fresh ? `The mosaic is older than the project: ${step.reason}.` : "";
  }

  /** Keys that the page takes: key, words, act. */
  get keys() {
    return /** @type {[string, string, () => void][]} */ ([
      ...MODES.map(([mode, title, key]) => [key.toLowerCase(), title.toLowerCase(), () => this.setMode(mode)]),
      ["enter", "end the line, or close the area", () => this.draw?.finishDrawing()],
      ["backspace", "take the last vertex back", () => this.draw?.removeLastPoint()],
      ["w", "compare with the mosaic before the last run", () => this.swipe.show(!this.swipe.on)],
      ["escape", "drop what was begun", () => this.setMode(this.mode === "look" || this.#begun() ? this.mode : "look")],
    ]);
  }

  /** Whether clicks on the map are for seams. */
  get placing() {
    return this.open && this.mode !== "look";
  }

  /** @param {any} view whether a place in it is waited for */
  awaits(view) {
    return this.open && view === this.view;
  }

  /** Whether what is pressed is held until it is dropped. */
  get holds() {
    return this.mode === "drag";
  }

  /** @param {boolean} on whether seams are what the side shows */
  show(on) {
    if (on !== this.open) this.#footprints(on);
    this.open = on;
    this.lines.show(on);
    if (on) this.load();
    else {
      this.swipe.show(false);
      this.photo.show("");
    }
    this.setMode("look");
  }

  /** @param {boolean} on whether footprints, which would hide the seams, are put away */
  #footprints(on) {
    const drawn = this.studio.entries.find((/** @type {any} */ one) => one.layer.id === "footprints")?.drawn;
    const shown = this.footprintsShown;
    this.footprintsShown = on && (shown || Boolean(drawn?.getVisible())); // the map may be drawn anew meanwhile
    drawn?.setVisible(!on && (shown || drawn.getVisible()));
  }

  /** Read the seams anew. */
  async load() {
    const serial = ++this.serial;
    await this.studio.attempt(async () => {
      const state = await get("/api/seams");
      if (serial === this.serial) this.render(state);
    });
  }

  /** @param {any} state as the server told it */
  render(state) {
    this.state = state;
    this.lines.set(state.seams);
    this.studio.showHistory(state.history);
    this.file.textContent = state.reason ? `No seams: ${state.reason}; ${state.hint}.`
      : state.file ? `Seams are those of ${state.file}.` : "Seams are the program's own; the first edit saves them in seams.gpkg, and the project file names it.";
    for (const [mode, button] of this.buttons) button.toggleAttribute("disabled", Boolean(state.reason) && mode !== "look");
    this.colours.show(state.images);
  }

  /**
   * Choose what the pointer does; what was begun is dropped.
   * @param {string} mode
   */
  setMode(mode) {
    if (this.state?.reason && mode !== "look") return;
    this.mode = mode;
    this.#drop(null);
    this.#clear();
    const { map, canvas } = this.view;
    for (const one of [this.pointer, this.draw]) if (one) map.removeInteraction(one);
    this.draw = null;
    for (const [name, button] of this.buttons) button.setAttribute("aria-pressed", String(this.open && name === mode));
    this.hint.textContent = MODES.find(([name]) => name === mode)?.[3] ?? "";
    canvas.classList.toggle("placing", this.open && mode in KINDS);
    canvas.classList.remove("taking");
    for (const one of map.getInteractions().getArray()) if (one instanceof ol.interaction.DoubleClickZoom) one.setActive(!this.placing);
    if (this.open && mode === "drag") map.addInteraction(this.pointer);
    if (this.open && mode in KINDS) this.#drawing(KINDS[mode]);
    this.view.cursor?.show();
  }

  /** @param {string} type of geometry */
  #drawing(type) {
    this.draw = new ol.interaction.Draw({ type, stopClick: true, snapTolerance: 6 });
    this.draw.on("drawstart", () => this.#clear());
    this.draw.on("drawend", (/** @type {any} */ event) => {
      const geometry = event.feature.getGeometry();
      if (type === "Polygon") this.choose(geometry);
      else if (this.mode === "redraw") this.#redraw(geometry.getCoordinates());
      else this.#cut(geometry.getCoordinates());
    });
    this.view.map.addInteraction(this.draw);
  }

  /** Whether something is under way that Escape drops first. */
  #begun() {
    return Boolean(this.taken || this.area || this.found.length || this.draw?.getOverlay().getSource().getFeatures().length);
  }

  #clear() {
    this.asked += 1;
    this.area = null;
    this.photo.area = null;
    this.photo.show("");
    this.found = [];
    this.lines.sketch([]);
    this.#renderPhotos();
  }

  /** @param {any} event */
  #take(event) {
    const keyboard = Boolean(this.view.cursor.place);
    this.taken = this.lines.near(event.coordinate, keyboard ? 60 : undefined);
    if (keyboard && !this.taken) this.studio.say("no seam is near the cross", true);
    return Boolean(this.taken);
  }

  /** @param {number[] | null} to where the seam is dropped; null leaves it */
  #drop(to) {
    const { taken } = this;
    this.taken = null;
    this.lines.sketch([]);
    if (taken && to && (to[0] !== taken.at[0] || to[1] !== taken.at[1])) this.#edit("drag", { place: taken.at, to, reach: this.lines.reach(taken.at, to) }, "seam moved");
  }

  /** @param {any} event */
  #click(event) {
    if (!this.open) return;
    if (this.mode === "look") this.#ask({ place: event.coordinate }, "Photos at this place");
    if (this.mode !== "cut") return;
    const piece = this.lines.sketches.getFeaturesAtCoordinate(event.coordinate).find((/** @type {any} */ one) => one.get("piece") !== undefined);
    if (piece && !this.area) this.choose(piece.getGeometry());
  }

  /** @param {number[][]} line */
  #redraw(line) {
    // Ends near a seam are on it.
    const ends = line.map((at, i) => (i === 0 || i === line.length - 1 ? this.lines.near(at)?.at ?? at : at));
    this.#edit("redraw", { line: ends }, "seam redrawn");
  }

  /** @param {number[][]} line */
  async #cut(line) {
    const asked = ++this.asked;
    await this.studio.attempt(async () => {
      const pieces = await send("POST", "/api/seams/pieces", { line });
      if (asked !== this.asked) return;
      const shapes = pieces.map((/** @type {any} */ one) => new ol.geom.Polygon([one.area]));
      this.lines.pieces(shapes);
      this.list.replaceChildren(element("h3", {}, "Choose a piece"), element("ul", { class: "list" }, ...pieces.map((/** @type {any} */ one, /** @type {number} */ i) =>
        element("li", {}, element("button", { class: "row", onclick: () => this.choose(shapes[i]) }, `${one.image}, ${this.#size(shapes[i])}`)))));
    });
  }

  /** @param {any} polygon that is to be given to a photo */
  choose(polygon) {
    this.area = polygon;
    this.photo.area = polygon;
    this.lines.sketch([polygon]);
    return this.#ask({ area: polygon.getCoordinates()[0] }, `Photos of the area, ${this.#size(polygon)}`);
  }

  /** @param {any} polygon */
  #size(polygon) {
    const main = this.studio.mapMain;
    return main.geographic ? "drawn" : `${shown(polygon.getArea() * main.metres_per_unit ** 2, 0)} m²`;
  }

  /**
   * List the photos of a place or an area.
   * @param {any} where
   * @param {string} title
   */
  async #ask(where, title) {
    if (!this.state || this.state.reason) return;
    const asked = ++this.asked;
    await this.studio.attempt(async () => {
      const found = await send("POST", "/api/seams/candidates", where);
      if (asked !== this.asked) return;
      this.found = found;
      this.title = title;
      this.#renderPhotos();
    });
  }

  #renderPhotos() {
    if (!this.found.length) return this.list.replaceChildren();
    const cards = this.found.map((one) => {
      const now = one.shows > 0.999 ? "shows it now" : one.shows > 0.001 ? `shows ${shown(100 * one.shows, 0)} % of it now` : "";
      const lacks = one.covers < 0.999 ? `does not show ${shown(100 - 100 * one.covers, 0)} %` : "";
      const see = element("button", { "aria-pressed": String(this.photo.name === one.name), "aria-label": `See ${one.name}`, onclick: () => this.see(one.name) }, "See");
      const give = this.area && one.shows <= 0.999 ? element("button", { class: lacks ? null : "primary", "aria-label": `Give the area to ${one.name}`, onclick: () => this.give(one.name) }, "Give") : null;
      return element("li", { class: "card" }, element("div", { class: "head" }, element("span", { title: one.name }, one.name), see, give),
        element("small", {}, [now, `best view ${shown(one.distance, 0)} m away`].filter(Boolean).join(", ")), lacks ? element("p", { class: "warn" }, lacks) : null);
    });
    return this.list.replaceChildren(element("h3", {}, this.title), element("ul", { class: "list" }, ...cards));
  }

  /** @param {string} name of a photo that is shown over the map, or no longer */
  async see(name) {
    this.colours.choose(name);
    const shown = this.studio.attempt(() => this.photo.show(this.photo.name === name ? "" : name));
    this.#renderPhotos();
    await shown;
  }

  /** @param {boolean} on */
  #lens(on) {
    this.photo.lens = on;
    this.photo.layer?.changed();
  }

  /** @param {string} name of the photo that gets the area */
  async give(name) {
    const { area } = this;
    const given = await this.#edit("give", { image: name, area: area.getCoordinates()[0] }, `area given to ${name}`);
    if (given && area === this.area) this.setMode(this.mode);
  }

  /**
   * @param {string} image
   * @param {number} gain
   * @param {number} offset
   */
  retouch(image, gain, offset) {
    return this.#edit("retouch", { image, gain, offset }, `colours of ${image}`);
  }

  /**
   * Send an edit; the run that it starts is told by its own events.
   * @param {string} act
   * @param {any} values
   * @param {string} done what is said
   */
  #edit(act, values, done) {
    return this.studio.attempt(async () => {
      const serial = ++this.serial, { ended } = this.studio.runs;
      const state = await edit("POST", `/api/seams/${act}`, values);
      if (done) this.studio.say(ended === this.studio.runs.ended ? `${done}; the mosaic is made anew there` : done);
      if (serial === this.serial) this.render(state);
      return true;
    });
  }
}
