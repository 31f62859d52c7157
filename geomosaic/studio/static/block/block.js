// The block: footprints, flight lines, tie points and residuals of the chosen image, images set aside and taken back.

import { edit, get } from "../api.js";
import { byId, element, shown } from "../dom.js";
import { Drawings } from "../drawings.js";
import { drawFootprints, drawRays, drawTies, lineColour } from "./drawing.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

// Points of the image that are listed, the largest residuals first.
const LISTED = 12;
// Pixels of the screen within which a point is chosen.
const BY_POINTER = 5, BY_KEYS = 20;
const STATES = /** @type {Record<string, string>} */ ({
  adjusted: "adjusted as one block", oriented: "oriented one by one", declared: "as declared: no step has run", none: "without orientation",
});

/** The tab of the block. */
export class BlockTool {
  placing = false; // no click of this tool places anything
  figures = element("div", { id: "block-figures" });
  stale = element("div", { id: "block-stale", "aria-live": "polite" });
  list = element("div", { id: "block-images" });
  points = element("div", { id: "block-points", "aria-live": "polite" });
  tiesBox = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", checked: true, onchange: () => this.draw() }));
  linesBox = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", checked: true, onchange: () => this.draw() }));

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    this.open = false;
    this.serial = 0;
    this.fitted = false; // the map has shown the whole block
    /** @type {any} */
    this.block = null;
    /** @type {any} */
    this.ties = null;
    /** @type {any} */
    this.rays = null;
    this.point = ""; // whose rays are shown, or asked for
    this.onImage = new Drawings(studio.imageView.map);
    this.onMap = new Drawings(studio.mapView.map);
    studio.tabs.panel("block").append(this.figures, this.stale,
      element("div", { class: "tools" }, element("label", {}, this.linesBox, "Footprints and lines"), element("label", {}, this.tiesBox, "Tie points")), this.points, this.list);
    studio.addEventListener("image", () => this.open && this.loadTies());
    studio.addEventListener("project", () => this.open && this.load());
    studio.addEventListener("steps", () => this.renderStale());
    studio.imageView.map.on("click", (/** @type {any} */ event) => this.#click(studio.imageView, this.onImage, event));
    studio.mapView.map.on("click", (/** @type {any} */ event) => this.#click(studio.mapView, this.onMap, event));
  }

  /** Keys that the page takes while the tab is open: key, words, act. */
  get keys() {
    return /** @type {[string, string, () => void][]} */ ([
      ["x", "set the image aside, or take it back", () => this.turnAside()],
      ["w", "the point with the largest residual, and the next largest", () => this.nextWorst()],
      ["escape", "leave the point", () => this.leavePoint()],
    ]);
  }

  /** Whether a place in a picture is waited for: a tie point is chosen there. */
  awaits() {
    return this.open && this.tiesBox.checked;
  }

  /** @param {boolean} on whether the block is what the side shows */
  show(on) {
    if (this.open && !on) this.studio.imageView.note.textContent = "";
    this.open = on;
    if (on) this.load();
    else {
      this.onImage.clear();
      this.onMap.clear();
    }
  }

  /** Layer whose map the places are for; none where the block's own map is shown. */
  #query() {
    const layer = this.studio.entries.find((/** @type {any} */ one) => one.drawn && one.layer.affine)?.layer;
    return layer ? `?layer=${layer.id}` : "";
  }

  /** Read the block anew. */
  async load() {
    const serial = ++this.serial;
    await this.studio.attempt(async () => {
      const block = await get(`/api/block${this.#query()}`);
      if (serial !== this.serial) return;
      this.block = block;
      this.studio.tabs.count("block", String(block.images.filter((/** @type {any} */ one) => !one.by).length));
      if (block.frame && !this.studio.mapView.home) {
        this.studio.mapView.startMap(block.frame, block.frame.crs_name);
        if (byId("views").dataset.view === "image") this.studio.chooseView("both");
      }
      if (!this.fitted) this.#fitMap(block.images.flatMap((/** @type {any} */ one) => one.footprint ?? []));
      this.fitted = true;
      await this.loadTies();
    });
  }

  /** Read the tie points of the image anew. */
  async loadTies() {
    const image = this.studio.image;
    const own = this.block?.images.find((/** @type {any} */ one) => one.id === image?.id);
    const serial = this.serial;
    if (this.ties && this.ties.image !== image?.name) {
      this.ties = null; // nothing of another image is drawn over it
      this.draw();
    }
    await this.studio.attempt(async () => {
      const ties = own?.points || own?.left_out ? await get(`/api/block/${image.id}/ties${this.#query()}`) : null;
      if (serial !== this.serial || image?.id !== this.studio.image?.id) return;
      this.ties = ties;
      if (this.rays && !ties?.points.some((/** @type {any} */ one) => one.id === this.rays.id)) this.rays = null;
      this.render();
    });
  }

  render() {
    const { block } = this;
    if (!block || !this.open) return;
    const known = block.images.filter((/** @type {any} */ one) => !one.by);
    const rays = Object.entries(block.rays).map(([count, points]) => `${count} rays: ${points}`).join(", ");
    const rows = [["Images", `${known.length}, ${STATES[block.state]}`], ["Flight lines", String(block.lines)]];
    if (block.sigma0 !== null && block.sigma0 !== undefined) rows.push(["sigma0", shown(block.sigma0, 2)]);
    this.figures.replaceChildren(element("dl", { class: "figures" }, ...rows.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)])),
      rays ? element("p", { class: "faint" }, `Tie points with ${rays}`) : "", block.reason ? element("p", { class: "warn" }, block.reason) : "");
    this.renderStale();
    this.#renderPoints();
    this.#renderImages();
    this.draw();
  }

  renderStale() {
    const stale = this.studio.steps.filter((/** @type {any} */ one) => !one.fresh).map((/** @type {any} */ one) => one.name);
    this.stale.replaceChildren(...(stale.length ? [element("div", { class: "card note" }, element("p", {}, `Stale: ${stale.join(", ")}`),
      element("button", { onclick: () => { this.studio.tabs.select("steps"); this.studio.runs.start([], false); } }, "Run what is stale"))] : []));
  }

  #renderImages() {
    const focused = /** @type {HTMLElement | null} */ (document.activeElement?.closest?.("#block-images [data-id]") ?? null)?.dataset;
    const groups = new Map();
    for (const image of this.block.images) groups.set(image.by ? "aside" : image.line, [...(groups.get(image.by ? "aside" : image.line) ?? []), image]);
    this.list.replaceChildren(...[...groups].map(([line, images]) => {
      const colour = element("span", { class: "swatch", "aria-hidden": "true" });
      colour.style.background = line === "aside" ? "transparent" : lineColour(line);
      const title = line === "aside" ? "Set aside" : line < 0 ? "Without a place" : `Flight line ${line + 1}`;
      return element("section", { "aria-label": title }, element("h3", { class: "group" }, colour, title), element("ul", { class: "list" }, ...images.map((/** @type {any} */ one) => this.#row(one))));
    }), ...this.#commented());
    if (focused) /** @type {HTMLElement | null} */ (this.list.querySelector(`[data-id="${focused.id}"][data-does="${focused.does}"]`))?.focus();
  }

  /** Images that the project file has as comments only, with the reason. */
  #commented() {
    const every = Object.entries(this.block.commented);
    if (!every.length) return [];
    const title = "Commented out in the project file";
    return [element("section", { "aria-label": title }, element("h3", { class: "group" }, title), element("ul", { class: "list" }, ...every.map(([name, reason]) =>
      element("li", { class: "pair" }, element("span", { class: "row words" }, element("span", {}, name), element("small", { class: "warn" }, reason)),
        element("button", { "aria-label": `Take back ${name}`, onclick: () => this.#takeBack(name) }, "Take back")))))];
  }

  /** @param {string} name of an image that is commented out */
  async #takeBack(name) {
    await this.studio.attempt(async () => {
      this.studio.showHistory((await edit("POST", "/api/block/commented", { name })).history);
      await this.studio.load();
      this.studio.say(`${name} taken back; Ctrl Z leaves it out again`);
    });
  }

  /** @param {any} image */
  #row(image) {
    const ties = image.points ? `${image.points} points, ${shown(image.mean_rays, 1)} rays` : "no tie point";
    const rms = image.rms === null ? "" : `, RMS ${shown(image.rms, 2)} px`;
    const out = image.left_out ? `, ${image.left_out} left out` : "";
    const words = image.by === "project" ? "set aside in the project file" : image.by ? `set aside by the adjustment: ${image.aside}` : `${ties}${rms}${out}`;
    const entry = this.studio.project?.images.find((/** @type {any} */ one) => one.id === image.id);
    const aside = image.by === "project";
    return element("li", { class: "pair" },
      element("button", { class: "row", "data-id": image.id, "data-does": "open", "aria-current": String(image.id === this.studio.image?.id), onclick: () => entry && this.studio.openImage(entry) },
        element("span", { class: "words" }, element("span", {}, image.name), element("small", { class: image.by ? "warn" : "" }, words), image.weak ? element("small", { class: "warn" }, image.weak) : null)),
      image.by === "adjustment" ? null : element("button", { "data-id": image.id, "data-does": "aside", "aria-label": `${aside ? "Take back" : "Set aside"} ${image.name}`, onclick: () => this.setAside(image, !aside) }, aside ? "Take back" : "Set aside"));
  }

  #renderPoints() {
    const { ties, rays } = this;
    if (rays) {
      const rows = rays.rays.map((/** @type {any} */ one) => element("li", {}, element("button", { class: "row", onclick: () => this.#goTo(one) },
        element("span", { class: "words" }, element("span", {}, one.name), element("small", { class: one.left_out ? "bad" : "" },
          `col ${shown(one.col, 1)}, row ${shown(one.row, 1)}${one.residual[0] === null ? "" : `, residual ${shown(Math.hypot(one.residual[0], one.residual[1]), 2)} px`}${one.left_out ? ", left out" : ""}`)))));
      this.points.replaceChildren(element("h3", { class: "group" }, `Point ${rays.id}: ${rays.rays.length} rays`, element("button", { onclick: () => this.leavePoint() }, "Back")), element("ul", { class: "list" }, ...rows));
    } else if (ties) {
      const rows = this.#worst().slice(0, LISTED).map((/** @type {any} */ one) => element("li", {}, element("button", { class: "chip", onclick: () => this.choosePoint(one.id) },
        `${one.id} ${shown(Math.hypot(one.residual[0], one.residual[1]), 2)} px${one.left_out ? ", left out" : ""}`)));
      this.points.replaceChildren(...(rows.length ? [element("h3", { class: "group" }, `Largest residuals in ${ties.image}`), element("ul", { class: "chips" }, ...rows)] : []));
    } else this.points.replaceChildren();
  }

  /** Points of the image with residuals, the largest first. */
  #worst() {
    const size = (/** @type {any} */ one) => Math.hypot(one.residual[0], one.residual[1]);
    return (this.ties?.points ?? []).filter((/** @type {any} */ one) => one.residual[0] !== null).sort((/** @type {any} */ a, /** @type {any} */ b) => size(b) - size(a));
  }

  nextWorst() {
    const every = this.#worst();
    const at = every.findIndex((/** @type {any} */ one) => one.id === this.rays?.id);
    if (every.length) this.choosePoint(every[(at + 1) % every.length].id);
  }

  /**
   * Show the rays of a point.
   * @param {string} name
   */
  async choosePoint(name) {
    this.point = name;
    await this.studio.attempt(async () => {
      const query = new URLSearchParams(this.#query().slice(1));
      query.set("point", name);
      const rays = await get(`/api/block/rays?${query}`);
      if (this.point !== name) return;
      this.rays = rays;
      const own = this.rays.rays.find((/** @type {any} */ one) => one.image === this.studio.image?.id);
      if (own) this.#centre(own);
      const centres = this.rays.rays.map((/** @type {any} */ one) => this.block.images.find((/** @type {any} */ image) => image.name === one.name)?.centre);
      this.#fitMap([this.rays.on_map, ...centres]);
      this.#renderPoints();
      this.draw();
      this.studio.say(`point ${name}: ${this.rays.rays.length} rays`);
    });
  }

  /** @param {(number[] | null | undefined)[]} places that the map shall show */
  #fitMap(places) {
    const known = places.filter((one) => one && one[0] !== null);
    const { map, home } = this.studio.mapView;
    if (!home || known.length < 2) return;
    const extent = ol.extent.boundingExtent(known);
    const view = map.getView();
    if (!ol.extent.containsExtent(view.calculateExtent(), extent)) view.fit(extent, { padding: [40, 40, 40, 40] });
  }

  leavePoint() {
    this.point = "";
    this.rays = null;
    this.#renderPoints();
    this.draw();
  }

  /** @param {any} ray whose image is opened where it shows the point */
  async #goTo(ray) {
    const entry = this.studio.project.images.find((/** @type {any} */ one) => one.id === ray.image);
    if (entry && entry.id !== this.studio.image?.id) await this.studio.openImage(entry);
    if (ray.image === this.studio.image?.id) this.#centre(ray);
  }

  /** @param {any} ray */
  #centre(ray) {
    const view = this.studio.imageView.map.getView();
    view.setCenter([ray.col, -ray.row]);
    if (view.getResolution() > 1) view.setResolution(1);
  }

  /** Set the chosen image aside, or take it back. */
  turnAside() {
    const image = this.block?.images.find((/** @type {any} */ one) => one.id === this.studio.opening?.id);
    if (image && image.by !== "adjustment") this.setAside(image, image.by !== "project");
  }

  /**
   * @param {any} image
   * @param {boolean} aside
   */
  async setAside(image, aside) {
    await this.studio.attempt(async () => {
      const { history } = await edit("POST", `/api/block/${image.id}/aside`, { aside });
      this.studio.showHistory(history);
      await this.studio.load();
      this.studio.say(`${image.name} ${aside ? "set aside; Ctrl Z takes it back" : "taken back"}`);
    });
  }

  /**
   * @param {any} view
   * @param {Drawings} drawings
   * @param {any} event
   */
  #click(view, drawings, event) {
    if (!this.open) return;
    let found = /** @type {string | null} */ (null);
    const keyboard = Boolean(view.cursor.place);
    view.map.forEachFeatureAtPixel(event.pixel, (/** @type {any} */ one) => { found ??= one.get("point") ?? null; }, { hitTolerance: keyboard ? BY_KEYS : BY_POINTER, layerFilter: (/** @type {any} */ one) => one === drawings.layer });
    if (found) this.choosePoint(found);
    else if (keyboard) this.studio.say("no tie point is near the cross", true);
  }

  draw() {
    this.onImage.clear();
    this.onMap.clear();
    const { block, studio } = this;
    if (!this.open || !block) return;
    let factor = 0;
    if (this.linesBox.checked && studio.mapView.home) drawFootprints(this.onMap, block.images, studio.image?.name ?? null);
    if (this.tiesBox.checked && this.ties) factor = drawTies({ image: this.onImage, map: this.onMap }, this.ties, [studio.image.width, studio.image.height], this.rays?.id ?? null);
    if (this.rays) drawRays(this.onMap, this.rays, block.images);
    studio.imageView.note.textContent = factor ? `residuals × ${shown(factor, 0)}` : "";
  }
}
