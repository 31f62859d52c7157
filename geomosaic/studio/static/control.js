// Control of the chosen image: points in image and map, live residuals, the next point. The server computes all of it.

import { get, send } from "./api.js";
import { byId, element, shown } from "./dom.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

// Drawn length of the longest residual, as a share of the pane's shorter side.
const LONGEST = 0.12;
const COLOURS = /** @type {Record<string, string>} */ ({ control: "#22c1b2", check: "#ffd166", off: "#9aa7b0", outside: "#9aa7b0", blamed: "#ff4d5e" });
const STATES = /** @type {Record<string, string>} */ ({ control: "control", check: "check", off: "off", outside: "beyond the part" });
const MODELS = /** @type {Record<string, string>} */ ({
  conformal: "Conformal", affine: "Affine", projective: "Projective", tps: "Thin plate spline", sensor: "Sensor model of the image",
});

/**
 * Number, or a dash where it is not known.
 * @param {number | null | undefined} value
 * @param {number} decimals
 */
const told = (value, decimals) => (value === null || value === undefined ? "–" : shown(value, decimals).replace(/^-(0\.?0*)$/, "$1"));

/** @param {(number | null)[] | undefined} pair of numbers, or of nothing */
const length = (pair) => (pair && pair[0] !== null && pair[1] !== null ? Math.hypot(pair[0], pair[1]) : null);

/** Layer of drawings over a pane, whatever raster it shows. */
class Drawings {
  /** @param {any} map OpenLayers' */
  constructor(map) {
    this.source = new ol.source.Vector();
    this.layer = new ol.layer.Vector({ source: this.source, zIndex: 50, map });
  }

  clear() {
    this.source.clear();
  }

  /**
   * @param {any} geometry
   * @param {any} style
   * @param {Record<string, any>} [facts]
   */
  add(geometry, style, facts = {}) {
    const feature = new ol.Feature({ geometry, ...facts });
    feature.setStyle(style);
    this.source.addFeature(feature);
  }
}

/** Measuring control points of the image that the studio shows. */
export class Control {
  choice = /** @type {HTMLSelectElement} */ (element("select", { id: "control-model", onchange: () => { this.model = this.choice.value; this.advice = null; this.load(); } }));
  placeButton = element("button", { id: "control-place", class: "primary", "aria-pressed": "false", onclick: () => this.place(!this.placing) }, "New point (P)");
  adviceButton = element("button", { id: "control-next", onclick: () => this.showAdvice() }, "Next point (N)");
  followBox = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", id: "control-follow", onchange: () => this.follow(this.followBox.checked) }));
  areaButton = element("button", { id: "control-area", onclick: () => this.useArea() }, "Fit only the part shown");
  writeButton = element("button", { id: "control-write", onclick: () => this.write() }, "Write the image on the map");
  hint = element("p", { class: "hint", id: "control-hint", "aria-live": "polite" });
  figures = element("div", { id: "control-figures" });
  messages = element("ul", { class: "list", id: "control-messages", "aria-label": "What is wrong with the points", "aria-live": "polite" });
  order = element("div", { id: "control-order" });
  table = element("tbody");

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    /** @type {any} */
    this.state = null;
    /** @type {any} */
    this.advice = null;
    this.model = "";
    /** @type {number[] | null} */
    this.area = null;
    /** @type {string | null} */
    this.selected = null;
    this.open = false;
    this.placing = false;
    this.again = false; // the next click moves the selected point
    this.following = false;
    this.serial = 0;
    this.savedAt = -Infinity; // when this page changed the table
    /** @type {{image: number[] | null, map: number[] | null, role: string}} */
    this.draft = { image: null, map: null, role: "control" };
    /** @type {{image: number[] | null, map: number[] | null}} */
    this.expected = { image: null, map: null };
    this.onImage = new Drawings(studio.imageView.map);
    this.onMap = new Drawings(studio.mapView.map);
    this.#prepare();
    studio.addEventListener("image", () => this.#other());
    studio.addEventListener("project", () => this.open && this.load());
    studio.imageView.map.on("click", (/** @type {any} */ event) => this.#click("image", event));
    studio.mapView.map.on("click", (/** @type {any} */ event) => this.#click("map", event));
    for (const [side, view] of [["image", studio.imageView], ["map", studio.mapView]]) {
      view.map.on("moveend", () => this.following && this.active === side && this.#follow(side));
      view.canvas.addEventListener("pointerenter", () => { this.active = side; });
      view.canvas.addEventListener("focus", () => { this.active = side; });
    }
    this.active = "image";
  }

  /** Keys that the page takes: key, words, act. */
  get keys() {
    const when = (/** @type {() => any} */ act) => () => this.open && act();
    return /** @type {[string, string, () => void][]} */ ([
      ["p", "control: a new point, by a click in the image and one on the map", when(() => this.place(!this.placing))],
      ["e", "control: take the place where the point is expected in the other picture", when(() => this.takeExpected())],
      ["m", "control: match what the map shows there in the image, to a fraction of a pixel", when(() => this.measure("match"))],
      ["c", "control: go to the centre of the mark at the place in the image", when(() => this.measure("mark"))],
      ["n", "control: where the next point helps most", when(() => this.showAdvice())],
      ["f", "control: the pictures follow each other", when(() => this.follow(!this.following))],
      ["x", "control: switch the chosen point off or on", when(() => this.toggle())],
      ["r", "control: measure the chosen point again, by the next click", when(() => this.measureAgain())],
      ["k", "control: make the chosen point a check point, or control", when(() => this.changeRole())],
      ["delete", "control: take the chosen point out", when(() => this.remove())],
      ["escape", "control: leave what was begun", when(() => this.place(false))],
    ]);
  }

  /** @returns {any} layer of the map that points are taken from */
  get mapLayer() {
    const drawn = this.studio.entries.filter((/** @type {any} */ one) => one.drawn && one.layer.affine);
    const visible = drawn.filter((/** @type {any} */ one) => one.drawn.getVisible());
    return (visible.find((/** @type {any} */ one) => one.layer.role === "reference") ?? visible[0] ?? drawn[0])?.layer ?? null;
  }

  /** @param {boolean} on whether control is what the side shows */
  show(on) {
    this.open = on;
    document.body.dataset.dock = on ? "open" : "closed";
    byId("dock").hidden = !on;
    requestAnimationFrame(() => [this.studio.imageView, this.studio.mapView].forEach((view) => view.map.updateSize()));
    if (on) this.load();
    else {
      this.place(false);
      this.onImage.clear();
      this.onMap.clear();
    }
  }

  /** Read the points and their solution anew. */
  async load() {
    await this.studio.attempt(() => this.#ask("GET", ""));
  }

  /**
   * Ask the server; its answer is the state of the points.
   * @param {string} method
   * @param {string} path
   * @param {any} [values]
   */
  async #ask(method, path, values) {
    const image = this.studio.image;
    if (!image || !this.studio.project.images.some((/** @type {any} */ one) => one.id === image.id)) return this.#nothing("Choose an image of the project.");
    const serial = ++this.serial;
    const address = `/api/control/${image.id}${path}?${this.#query()}`;
    let state;
    if (method !== "GET") {
      this.advice = null;
      this.savedAt = performance.now();
    }
    try {
      state = method === "GET" ? await get(address) : await send(method, address, values);
    } catch (error) {
      if (method === "GET") this.#nothing(/** @type {Error} */ (error).message);
      throw error;
    }
    if (serial !== this.serial) return;
    this.state = state;
    if (!this.model) this.model = state.model;
    this.studio.showHistory(state.history);
    if (!state.points.some((/** @type {any} */ one) => one.id === this.selected)) this.selected = null;
    this.render();
  }

  #query() {
    const found = new URLSearchParams();
    if (this.model && this.model !== "sensor") found.set("model", this.model);
    if (this.area) found.set("area", this.area.map((value) => value.toFixed(1)).join(","));
    if (this.mapLayer) found.set("layer", this.mapLayer.id);
    return found;
  }

  /** @param {string} why there is nothing to show */
  #nothing(why) {
    this.state = null;
    this.figures.replaceChildren(element("p", { class: "empty" }, why));
    this.messages.replaceChildren();
    this.table.replaceChildren();
    this.draw();
  }

  #other() {
    this.model = "";
    this.area = null;
    this.selected = null;
    this.advice = null;
    this.place(false);
    this.state = null;
    this.onImage.clear();
    this.onMap.clear();
    if (this.open) this.load();
  }

  #prepare() {
    this.studio.tabs.panel("control").append(
      element("div", { class: "tools" }, element("label", { for: "control-model" }, "Model"), this.choice),
      element("div", { class: "tools" }, this.placeButton, this.adviceButton), this.hint, this.figures, this.messages, this.order,
      element("div", { class: "tools" }, element("label", {}, this.followBox, "Pictures follow each other")),
      element("div", { class: "tools" }, this.areaButton, this.writeButton),
    );
    const heads = ["", "Point", "State", "col", "row", "x", "y", "Residual", "Δcol", "Δrow", "Left out", "Checked", "RMS otherwise", ""];
    const titles = ["On or off", "", "", "", "", "", "", "Length of the residual, pixels", "Pixels", "Pixels",
      "Error under the fit to the others, pixels", "Share of the measurement that the others check", "RMS of the fit without this point, or with it where it is off", ""];
    byId("dock").append(element("table", { id: "control-table" }, element("caption", { class: "hidden" }, "Control points of the image"),
      element("thead", {}, element("tr", {}, ...heads.map((head, i) => element("th", { scope: "col", title: titles[i] || null }, head)))), this.table));
  }

  /** Show the state that the server told last. */
  render() {
    const { state } = this;
    if (!state) return;
    this.choice.replaceChildren(...(state.models.length ? state.models : [state.model]).map((/** @type {string} */ name) =>
      element("option", { value: name }, MODELS[name] ?? `Polynomial of order ${name.slice(4)}`)));
    this.choice.value = state.models.length ? this.model : state.model;
    this.writeButton.hidden = !state.models.length;
    this.areaButton.textContent = this.area ? "Fit the whole image" : "Fit only the part shown";
    this.studio.tabs.count("control", state.points.length ? String(state.points.length) : "", state.messages.some((/** @type {any} */ one) => one.severity === "error"));
    this.#renderFigures();
    this.messages.replaceChildren(...state.messages.map((/** @type {any} */ one) => element("li", { class: `card ${one.severity === "error" ? "error" : "note"}` },
      element("p", {}, one.what), element("p", { class: "faint" }, one.hint),
      ...one.points.map((/** @type {string} */ name) => element("button", { onclick: () => this.select(name, true) }, `Show ${name}`)))));
    this.#renderTable();
    this.#renderOrder();
    this.draw();
  }

  #renderFigures() {
    const { solution, reason } = this.state;
    if (!solution) return this.figures.replaceChildren(element("p", { class: "empty" }, `No solution yet: ${reason}`));
    const rows = /** @type {[string, string, string][]} */ ([
      ["RMS", `${told(solution.rms, 2)} px`, "Root mean square length of the residuals"],
      ["of col, row", `${told(solution.rms_axes[0], 2)}, ${told(solution.rms_axes[1], 2)} px`, ""],
      ["Left out", solution.leave_one_out === null ? "–" : `${told(solution.leave_one_out, 2)} px`, "RMS error of each point under the fit to the others"],
      ["Check points", solution.check_rms === null ? "–" : `${told(solution.check_rms, 2)} px`, "RMS at points that take no part"],
      ["sigma0", told(solution.sigma0, 2), "Standard deviation of unit weight"],
      ["Redundancy", String(solution.redundancy), "Observations, a-priori values among them, less unknowns"],
    ]);
    this.figures.replaceChildren(element("dl", { class: "figures" }, ...rows.flatMap(([name, value, title]) => [
      element("dt", { title: title || null }, name), element("dd", {}, value)])));
  }

  #renderTable() {
    const { state } = this;
    const rows = state.points.map((/** @type {any} */ point) => {
      const box = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", "aria-label": `Point ${point.id} takes part`, onchange: () => this.change(point.id, { enabled: box.checked }) }));
      box.checked = point.enabled;
      const part = point.redundancy ? Math.min(...point.redundancy) : null;
      const numbers = [told(point.col, 2), told(point.row, 2), point.ground[0], point.ground[1],
        told(length(point.residual), 2), told(point.residual?.[0], 2), told(point.residual?.[1], 2),
        told(length(point.left_out), 2), part === null ? "–" : `${Math.round(100 * part)} %`, told(point.toggled?.rms, 2)];
      const row = element("tr", { tabindex: "0", "data-id": point.id, "aria-selected": String(point.id === this.selected), class: point.blamed ? "blamed" : point.state,
        onclick: () => this.select(point.id, true), onkeydown: (/** @type {KeyboardEvent} */ event) => this.#rowKey(event, point.id) },
        element("td", {}, box), element("th", { scope: "row" }, point.id), element("td", {}, STATES[point.state]),
        ...numbers.map((text) => element("td", { class: "number" }, text)),
        element("td", {}, element("button", { "aria-label": `Take point ${point.id} out`, title: "Take out", onclick: (/** @type {Event} */ event) => { event.stopPropagation(); this.remove(point.id); } }, "✕")));
      box.addEventListener("click", (event) => event.stopPropagation());
      return row;
    });
    const focused = /** @type {HTMLElement | null} */ (document.activeElement?.closest?.("#control-table tr[data-id]") ?? null)?.dataset.id;
    this.table.replaceChildren(...(rows.length ? rows : [element("tr", {}, element("td", { colspan: 14, class: "empty" }, "No point yet: press P, then click in the image and on the map."))]));
    if (focused) /** @type {HTMLElement | undefined} */ (rows.find((/** @type {any} */ row) => row.dataset.id === focused))?.focus();
  }

  /**
   * @param {KeyboardEvent} event
   * @param {string} name
   */
  #rowKey(event, name) {
    const row = /** @type {HTMLElement} */ (event.currentTarget);
    const next = event.key === "ArrowDown" ? row.nextElementSibling : event.key === "ArrowUp" ? row.previousElementSibling : null;
    if (next) /** @type {HTMLElement} */ (next).focus();
    else if (event.key === "Enter") this.select(name, true);
    else return;
    event.preventDefault();
  }

  #renderOrder() {
    const { advice } = this;
    if (!advice) return this.order.replaceChildren();
    const unit = advice.unit;
    const digits = advice.rms < 0.1 ? 3 : advice.rms < 10 ? 2 : 0;
    const list = advice.order.slice(0, 8).map((/** @type {any} */ one, /** @type {number} */ i) => element("li", {},
      element("button", { class: "row", onclick: () => this.goTo(one) }, element("strong", {}, String(i + 1)),
        element("span", { class: "words" }, element("span", {}, one.id ? `point ${one.id}` : `col ${shown(one.col, 0)}, row ${shown(one.row, 0)}`),
          element("small", {}, `expected error then ${shown(one.rms, digits)} ${unit}`)))));
    this.order.replaceChildren(element("p", {}, element("strong", {}, "Next point"), ` expected error now ${shown(advice.rms, digits)} ${unit} RMS over the image; in the image, what it would be with one more point there: `,
      element("span", { class: "ramp" }, "less"), " to ", element("span", { class: "ramp far" }, "as now")), element("ol", { class: "list" }, ...list));
  }

  /** Draw points, residuals, the expected place and the advice over both pictures. */
  draw() {
    this.onImage.clear();
    this.onMap.clear();
    const { state } = this;
    if (!this.open || !state) return;
    this.#drawAdvice();
    const scale = this.#vectorScale();
    const view = this.studio.mapView;
    for (const point of state.points) {
      const colour = point.blamed ? COLOURS.blamed : COLOURS[point.state];
      const chosen = point.id === this.selected;
      const mark = this.#mark(colour, point.id, chosen, point.state === "check");
      const at = [point.col, -point.row];
      this.onImage.add(new ol.geom.Point(at), mark, { point: point.id });
      if (view.home && point.on_map?.[0] !== null && point.on_map) this.onMap.add(new ol.geom.Point(point.on_map), mark, { point: point.id });
      if (!scale || !point.residual || point.residual[0] === null) continue;
      const stroke = new ol.style.Style({ stroke: new ol.style.Stroke({ color: colour, width: 2.5 }) });
      // From where the solution puts the point to where it was measured, lengthened.
      const start = [at[0] - point.residual[0], at[1] + point.residual[1]];
      this.onImage.add(new ol.geom.LineString([start, [start[0] + scale * point.residual[0], start[1] - scale * point.residual[1]]]), stroke);
      if (view.home && point.measured_on_map && point.measured_on_map[0] !== null) {
        const [x, y] = point.on_map;
        this.onMap.add(new ol.geom.LineString([[x, y], [x + scale * (point.measured_on_map[0] - x), y + scale * (point.measured_on_map[1] - y)]]), stroke);
      }
    }
    this.#drawDraft();
    this.studio.imageView.note.textContent = scale ? `residuals × ${shown(scale, 0)}` : "";
    this.studio.mapView.note.textContent = scale && view.home ? `residuals × ${shown(scale, 0)}` : "";
  }

  /** Round factor that draws the longest residual in a convenient length; 0 without residuals. */
  #vectorScale() {
    const lengths = this.state.points.map((/** @type {any} */ one) => length(one.residual) ?? 0);
    const longest = Math.max(0, ...lengths);
    if (!(longest > 1e-6)) return 0;
    const [width, height] = this.state.size;
    const wanted = (LONGEST * Math.min(width, height)) / longest;
    const power = 10 ** Math.floor(Math.log10(wanted));
    return Math.max(1, [1, 2, 5].map((step) => step * power).filter((step) => step <= wanted).at(-1) ?? 1);
  }

  /**
   * @param {string} colour
   * @param {string} name
   * @param {boolean} chosen
   * @param {boolean} check drawn as a triangle
   */
  #mark(colour, name, chosen, check) {
    const radius = chosen ? 9 : 6;
    const looks = { radius, stroke: new ol.style.Stroke({ color: colour, width: chosen ? 3.5 : 2.2 }), fill: new ol.style.Fill({ color: "rgba(0,0,0,.15)" }) };
    return [
      new ol.style.Style({ image: check ? new ol.style.RegularShape({ ...looks, points: 3 }) : new ol.style.Circle(looks) }),
      new ol.style.Style({
        image: new ol.style.Circle({ radius: 1.5, fill: new ol.style.Fill({ color: colour }) }),
        text: new ol.style.Text({ text: name, offsetX: 11, offsetY: -11, textAlign: "left", font: "600 13px system-ui, sans-serif",
          fill: new ol.style.Fill({ color: "#fff" }), stroke: new ol.style.Stroke({ color: "#10181d", width: 3.5 }) }),
      }),
    ];
  }

  #drawDraft() {
    const own = new ol.style.Style({ image: new ol.style.RegularShape({ points: 4, radius: 13, radius2: 0, angle: 0, stroke: new ol.style.Stroke({ color: "#fff", width: 2.5 }) }), zIndex: 3 });
    const ring = new ol.style.Style({ image: new ol.style.Circle({ radius: 14, stroke: new ol.style.Stroke({ color: "#fff", width: 2, lineDash: [5, 5] }) }), zIndex: 2 });
    if (this.draft.image) this.onImage.add(new ol.geom.Point([this.draft.image[0], -this.draft.image[1]]), own);
    if (this.draft.map) this.onMap.add(new ol.geom.Point(this.draft.map), own);
    if (this.expected.image && !this.draft.image) this.onImage.add(new ol.geom.Point([this.expected.image[0], -this.expected.image[1]]), ring);
    if (this.expected.map && !this.draft.map) this.onMap.add(new ol.geom.Point(this.expected.map), ring);
  }

  #drawAdvice() {
    const { advice } = this;
    if (!advice) return;
    const rows = advice.rms_with.length, cols = advice.rms_with[0].length;
    const [width, height] = advice.size;
    const known = advice.rms_with.flat().filter((/** @type {any} */ value) => value !== null);
    const least = Math.min(...known), most = Math.max(...known);
    for (let i = 0; i < rows; i += 1) {
      for (let j = 0; j < cols; j += 1) {
        const value = advice.rms_with[i][j];
        if (value === null) continue;
        const share = most > least ? (most - value) / (most - least) : 0;
        const [left, right, top, bottom] = [(j * width) / cols, ((j + 1) * width) / cols, (-i * height) / rows, (-(i + 1) * height) / rows];
        const cell = new ol.geom.Polygon([[[left, top], [right, top], [right, bottom], [left, bottom], [left, top]]]);
        this.onImage.add(cell, new ol.style.Style({ fill: new ol.style.Fill({ color: `rgba(${Math.round(40 + 215 * share)}, ${Math.round(60 + 120 * share)}, 60, ${(0.08 + 0.47 * share).toFixed(2)})` }), zIndex: -2 }));
      }
    }
    for (const [i, one] of advice.order.slice(0, 8).entries()) {
      this.onImage.add(new ol.geom.Point([one.col, -one.row]), new ol.style.Style({ zIndex: -1,
        image: new ol.style.Circle({ radius: 11, fill: new ol.style.Fill({ color: "#ffb703" }), stroke: new ol.style.Stroke({ color: "#10181d", width: 1.5 }) }),
        text: new ol.style.Text({ text: String(i + 1), font: "700 12px system-ui, sans-serif", fill: new ol.style.Fill({ color: "#10181d" }) }) }));
    }
  }

  /**
   * Begin or leave a new point.
   * @param {boolean} on
   */
  place(on) {
    this.placing = on;
    this.again = false;
    this.draft = { image: null, map: null, role: "control" };
    this.expected = { image: null, map: null };
    this.placeButton.setAttribute("aria-pressed", String(on));
    this.hint.textContent = on ? "Click the point in the image and on the map, in either order. E takes the expected place, M matches, C centres a mark, Esc leaves." : "";
    for (const view of [this.studio.imageView, this.studio.mapView]) {
      view.canvas.classList.toggle("placing", on);
      // OpenLayers takes two quick clicks for a double one, wherever they are.
      for (const one of view.map.getInteractions().getArray()) if (one instanceof ol.interaction.DoubleClickZoom) one.setActive(!on);
    }
    if (on && this.studio.mapView.home && byId("views").dataset.view !== "both") this.studio.chooseView("both");
    this.draw();
  }

  /**
   * @param {"image" | "map"} side
   * @param {any} event
   */
  #click(side, event) {
    if (!this.open || !this.state) return;
    const [x, y] = event.coordinate;
    const at = side === "image" ? [x, -y] : [x, y];
    if (this.again && this.selected) return this.#moveSelected(side, at);
    if (!this.placing) {
      const drawings = side === "image" ? this.onImage : this.onMap;
      const map = (side === "image" ? this.studio.imageView : this.studio.mapView).map;
      let found = /** @type {string | null} */ (null);
      map.forEachFeatureAtPixel(event.pixel, (/** @type {any} */ feature) => { found ??= feature.get("point") ?? null; }, { hitTolerance: 6, layerFilter: (/** @type {any} */ one) => one === drawings.layer });
      if (found) this.select(found, false);
      return;
    }
    this.setHalf(side, at);
  }

  /**
   * One half of the point that is placed; the other half's expected place is shown.
   * @param {"image" | "map"} side
   * @param {number[]} at pixels of the image, or map coordinates
   */
  async setHalf(side, at) {
    this.draft[side] = at;
    const other = side === "image" ? "map" : "image";
    if (this.draft.image && this.draft.map) return this.#addDraft();
    this.draw();
    await this.studio.attempt(async () => {
      this.expected[other] = await this.#expectedAt(side, at);
      if (this.expected[other]) this.#centre(other, this.expected[other]);
      this.draw();
    });
  }

  /**
   * Where a place of one side is expected on the other; null where nothing tells.
   * @param {"image" | "map"} side
   * @param {number[]} at
   */
  async #expectedAt(side, at) {
    const layer = this.mapLayer;
    if (!layer || !this.state?.predicts) return null;
    const query = this.#query();
    const pixel = side === "map" ? this.#layerPixel(at) : at;
    query.set(side === "map" ? "map_col" : "col", String(pixel[0]));
    query.set(side === "map" ? "map_row" : "row", String(pixel[1]));
    const found = await get(`/api/control/${this.studio.image.id}/expected?${query}`);
    if (found.col === null) return null;
    return side === "map" ? [found.col, found.row] : this.#mapPlace([found.col, found.row]);
  }

  /** @param {number[]} at map coordinates */
  #layerPixel(at) {
    const [a, , c, , e, f] = this.mapLayer.affine;
    return [(at[0] - c) / a, (at[1] - f) / e];
  }

  /** @param {number[]} pixel of the layer */
  #mapPlace(pixel) {
    const [a, , c, , e, f] = this.mapLayer.affine;
    return [c + a * pixel[0], f + e * pixel[1]];
  }

  async #addDraft() {
    const { image, map, role } = this.draft;
    if (!image || !map) return;
    const [mapCol, mapRow] = this.#layerPixel(map);
    await this.studio.attempt(async () => {
      await this.#ask("POST", "/points", { col: image[0], row: image[1], layer: this.mapLayer.id, map_col: mapCol, map_row: mapRow, role });
      this.studio.say(`point ${this.state.points.at(-1).id} measured`);
    });
    this.place(true);
  }

  /** Take the expected place for the half that is missing. */
  takeExpected() {
    for (const side of /** @type {("image" | "map")[]} */ (["image", "map"])) {
      if (!this.draft[side] && this.expected[side]) return this.setHalf(side, this.expected[side]);
    }
    this.studio.say("no place is expected: click in one picture first; it takes two or three points", true);
    return undefined;
  }

  /**
   * Sub-pixel place in the image.
   * @param {"match" | "mark"} way
   */
  async measure(way) {
    const chosen = this.state?.points.find((/** @type {any} */ one) => one.id === this.selected);
    const image = this.draft.image ?? this.expected.image ?? (chosen ? [chosen.col, chosen.row] : null);
    const map = this.draft.map ?? chosen?.on_map ?? null;
    let body;
    if (way === "mark") {
      if (!image) return this.studio.say("click near the mark in the image first", true);
      body = { way, col: image[0], row: image[1] };
    } else {
      if (!map) return this.studio.say("click the place on the map first", true);
      const [mapCol, mapRow] = this.#layerPixel(map);
      body = { way, layer: this.mapLayer.id, map_col: mapCol, map_row: mapRow };
    }
    await this.studio.attempt(async () => {
      const found = await send("POST", `/api/control/${this.studio.image.id}/measure?${this.#query()}`, body);
      this.studio.say(`${way === "match" ? "matched" : "centred"} at col ${shown(found.col, 2)}, row ${shown(found.row, 2)}, ± ${shown(found.sigma, 3)} px`);
      if (this.placing) await this.setHalf("image", [found.col, found.row]);
      else if (chosen) await this.change(chosen.id, { col: found.col, row: found.row });
    });
  }

  /**
   * @param {string} name
   * @param {boolean} centre both pictures on it
   */
  select(name, centre) {
    this.selected = name;
    const point = this.state.points.find((/** @type {any} */ one) => one.id === name);
    if (centre && point) {
      this.#centre("image", [point.col, point.row], true);
      if (point.on_map && point.on_map[0] !== null) this.#centre("map", point.on_map, true);
    }
    for (const row of this.table.querySelectorAll("tr[data-id]")) row.setAttribute("aria-selected", String(/** @type {HTMLElement} */ (row).dataset.id === name));
    this.draw();
  }

  /**
   * @param {string} side
   * @param {number[]} at
   * @param {boolean} [near] at least at the raster's own scale
   */
  #centre(side, at, near = false) {
    const view = side === "image" ? this.studio.imageView : this.studio.mapView;
    if (!view.home) return;
    const pixel = side === "image" ? 1 : this.mapLayer.affine[0];
    const here = view.map.getView();
    const place = side === "image" ? [at[0], -at[1]] : at;
    const [left, bottom, right, top] = here.calculateExtent();
    const inside = Math.abs(place[0] - (left + right) / 2) < 0.4 * (right - left) && Math.abs(place[1] - (bottom + top) / 2) < 0.4 * (top - bottom);
    if (inside && !near) return; // a picture that shows the place stays as it is
    here.setCenter(place);
    if (near && here.getResolution() > pixel) here.setResolution(pixel);
  }

  /** @param {boolean} on */
  follow(on) {
    this.following = on;
    this.followBox.checked = on;
    if (on) this.#follow(this.active);
  }

  /** @param {string} side that leads */
  async #follow(side) {
    const [lead, other] = side === "image" ? [this.studio.imageView, this.studio.mapView] : [this.studio.mapView, this.studio.imageView];
    if (!this.open || !lead.home || !other.home) return;
    const [x, y] = lead.map.getView().getCenter();
    await this.studio.attempt(async () => {
      const found = await this.#expectedAt(/** @type {any} */ (side), side === "image" ? [x, -y] : [x, y]);
      if (found) other.map.getView().setCenter(side === "image" ? found : [found[0], -found[1]]);
    });
  }

  /**
   * Change a point.
   * @param {string} name
   * @param {any} values
   */
  async change(name, values) {
    await this.studio.attempt(() => this.#ask("PATCH", `/points/${encodeURIComponent(name)}`, values));
  }

  toggle() {
    const point = this.state?.points.find((/** @type {any} */ one) => one.id === this.selected);
    if (point) this.change(point.id, { enabled: !point.enabled });
  }

  changeRole() {
    const point = this.state?.points.find((/** @type {any} */ one) => one.id === this.selected);
    if (point) this.change(point.id, { role: point.role === "check" ? "control" : "check" });
  }

  measureAgain() {
    if (!this.selected) return this.studio.say("choose a point first", true);
    this.place(false);
    this.again = true;
    this.hint.textContent = `Click where point ${this.selected} is, in the image or on the map; Esc leaves it.`;
    return undefined;
  }

  /**
   * @param {string} side
   * @param {number[]} at
   */
  async #moveSelected(side, at) {
    const name = /** @type {string} */ (this.selected);
    this.again = false;
    this.hint.textContent = "";
    const [first, second] = side === "image" ? at : this.#layerPixel(at);
    await this.change(name, side === "image" ? { col: first, row: second } : { layer: this.mapLayer.id, map_col: first, map_row: second });
  }

  /** @param {string | null} [name] */
  async remove(name = this.selected) {
    if (!name) return;
    await this.studio.attempt(() => this.#ask("DELETE", `/points/${encodeURIComponent(name)}`));
    this.studio.say(`point ${name} taken out; Ctrl Z brings it back`);
  }

  /** Ask where one more point helps most, and draw it; once more takes it away. */
  async showAdvice() {
    if (this.advice) {
      this.advice = null;
      this.render();
      return;
    }
    await this.studio.attempt(async () => {
      this.advice = await get(`/api/control/${this.studio.image.id}/next?${this.#query()}`);
      this.studio.imageView.fit();
      if (byId("views").dataset.view === "map") this.studio.chooseView("both");
      this.render();
    });
  }

  /** @param {any} one of the order */
  async goTo(one) {
    this.#centre("image", [one.col, one.row], true);
    await this.studio.attempt(async () => {
      const there = await this.#expectedAt("image", [one.col, one.row]);
      if (there) this.#centre("map", there, true);
    });
  }

  /** Fit only what the image pane shows, or the whole image again. */
  useArea() {
    if (this.area) this.area = null;
    else {
      const [left, bottom, right, top] = this.studio.imageView.map.getView().calculateExtent();
      this.area = [left, -top, right, -bottom];
    }
    this.advice = null;
    this.load();
  }

  /** Write the image placed on the map. */
  async write() {
    await this.studio.attempt(async () => {
      this.studio.say("the image is drawn on the map …");
      const made = await send("POST", `/api/control/${this.studio.image.id}/georeference?${this.#query()}`);
      await this.studio.load();
      this.studio.say(`${made.file} written: ${made.model}, ${made.points} points, RMS ${shown(made.rms, 2)} px`);
    });
  }
}
