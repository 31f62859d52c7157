// Control of the chosen image: points in image and map, live residuals, the next point. The server computes all of it.

import { edit, editsMade, get, send } from "../api.js";
import { byId, element, shown } from "../dom.js";
import { Advice } from "./advice.js";
import { drawControl } from "./drawing.js";
import { told } from "./numbers.js";
import { Panes } from "./panes.js";
import { Placement } from "./placement.js";
import { PointTable } from "./table.js";

const MODELS = /** @type {Record<string, string>} */ ({
  conformal: "Conformal", affine: "Affine", projective: "Projective", tps: "Thin plate spline", sensor: "Sensor model of the image",
});

/** The tab of control: the state of the points as the server told it last, and what changes it. */
export class Control {
  choice = /** @type {HTMLSelectElement} */ (element("select", { id: "control-model", onchange: () => { this.model = this.choice.value; this.advice.clear(); this.load(); } }));
  followBox = /** @type {HTMLInputElement} */ (element("input", { type: "checkbox", id: "control-follow", onchange: () => this.follow(this.followBox.checked) }));
  areaButton = element("button", { id: "control-area", onclick: () => this.useArea() }, "Fit only the part shown");
  writeButton = element("button", { id: "control-write", onclick: () => this.write() }, "Write the image on the map");
  figures = element("div", { id: "control-figures" });
  messages = element("ul", { class: "list", id: "control-messages", "aria-label": "What is wrong with the points", "aria-live": "polite" });

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    /** @type {any} */
    this.state = null;
    this.model = "";
    /** @type {number[] | null} */
    this.area = null;
    /** @type {string | null} */
    this.selected = null;
    this.open = false;
    this.serial = 0;
    this.panes = new Panes(this);
    this.placement = new Placement(this);
    this.advice = new Advice(this);
    this.table = new PointTable(this);
    studio.tabs.panel("control").append(
      element("div", { class: "tools" }, element("label", { for: "control-model" }, "Model"), this.choice),
      element("div", { class: "tools" }, this.placement.button, element("button", { id: "control-next", onclick: () => this.advice.toggle() }, "Next point (N)")),
      this.placement.hint, this.figures, this.messages, this.advice.list,
      element("div", { class: "tools" }, element("label", {}, this.followBox, "Pictures follow each other")),
      element("div", { class: "tools" }, this.areaButton, this.writeButton),
    );
    studio.addEventListener("image", () => this.#other());
    studio.addEventListener("crs", () => this.open && this.placement.start(false));
    studio.addEventListener("takenback", () => this.advice.clear());
    studio.addEventListener("project", () => this.open && this.load());
  }

  /** Keys that the page takes: key, words, act. */
  get keys() {
    return /** @type {[string, string, () => void][]} */ ([
      ["p", "a new point, by a click, or the cross and Enter, in the image and on the map", () => this.placement.start(!this.placement.on)],
      ["e", "take the place where the point is expected in the other picture", () => this.placement.takeExpected()],
      ["m", "match what the map shows there in the image, to a fraction of a pixel", () => this.placement.measure("match")],
      ["c", "go to the centre of the mark at the place in the image", () => this.placement.measure("mark")],
      ["n", "where the next point helps most", () => this.advice.toggle()],
      ["g", "go to the place where the next point helps most", () => this.advice.goToFirst()],
      ["f", "the pictures follow each other", () => this.follow(!this.panes.following)],
      ["x", "switch the chosen point off or on", () => this.chosen && this.change(this.chosen, { enabled: !this.chosen.enabled })],
      ["r", "measure the chosen point again, by the next click", () => this.placement.measureAgain()],
      ["k", "make the chosen point a check point, or control", () => this.chosen && this.change(this.chosen, { role: this.chosen.role === "check" ? "control" : "check" })],
      ["delete", "take the chosen point out", () => this.remove()],
      ["escape", "leave what was begun", () => this.placement.start(false)],
    ]);
  }

  /** Whether a place in a picture is waited for. */
  awaits() {
    return this.placement.on || this.placement.again;
  }

  /** Whether clicks in the pictures place a point. */
  get placing() {
    return this.placement.on;
  }

  /** What undo waits for. */
  get saving() {
    return this.placement.measuring;
  }

  /** @returns {any} the chosen point, undefined where there is none */
  get chosen() {
    return this.state?.points.find((/** @type {any} */ one) => one.id === this.selected);
  }

  /** @param {boolean} on whether control is what the side shows */
  show(on) {
    this.open = on;
    document.body.dataset.dock = on ? "open" : "closed";
    byId("dock").hidden = !on;
    requestAnimationFrame(() => [this.studio.imageView, this.studio.mapView].forEach((view) => view.map.updateSize()));
    if (on) this.load();
    else {
      this.placement.start(false);
      this.panes.clear();
    }
  }

  /** Read the points and their solution anew. */
  async load() {
    await this.studio.attempt(() => this.ask("GET", ""));
  }

  /**
   * Ask the server; its answer is the state of the points.
   * @param {string} method
   * @param {string} path
   * @param {any} [values]
   * @returns {Promise<any>} the answer, which is shown where nothing was asked after it; undefined where there is none
   */
  async ask(method, path, values) {
    const serial = ++this.serial;
    if (method === "GET") {
      await editsMade();
      if (serial !== this.serial) return undefined;
    }
    const image = this.studio.image;
    if (!image || !this.studio.project.images.some((/** @type {any} */ one) => one.id === image.id)) {
      this.#nothing("Choose an image of the project.");
      return undefined;
    }
    const address = `/api/control/${image.id}${path}?${this.query()}`;
    let state;
    if (method !== "GET") this.advice.clear();
    try {
      state = method === "GET" ? await get(address) : await edit(method, address, values);
    } catch (error) {
      if (serial !== this.serial && method === "GET") return undefined;
      if (method === "GET") this.#nothing(/** @type {Error} */ (error).message);
      throw error;
    }
    if (serial !== this.serial) return state;
    this.state = state;
    if (!this.model) this.model = state.model;
    this.studio.showHistory(state.history);
    if (!this.chosen) this.selected = null;
    this.render();
    return state;
  }

  /** Model, part of the image and layer of the map that the server's answers are for. */
  query() {
    const found = new URLSearchParams();
    if (this.model && this.model !== "sensor") found.set("model", this.model);
    if (this.area) found.set("area", this.area.map((value) => value.toFixed(1)).join(","));
    if (this.panes.layer) found.set("layer", this.panes.layer.id);
    return found;
  }

  /** @param {string} why there is nothing to show */
  #nothing(why) {
    this.state = null;
    this.figures.replaceChildren(element("p", { class: "empty" }, why));
    this.messages.replaceChildren();
    this.table.clear();
    this.draw();
  }

  #other() {
    this.serial += 1;
    this.panes.serial += 1;
    this.model = "";
    this.area = null;
    this.selected = null;
    this.advice.clear();
    if (this.open) this.placement.start(false); // else another tool may be drawing
    this.state = null;
    this.panes.clear();
    if (this.open) this.load();
  }

  /** Show the state that the server told last. */
  render() {
    const { state } = this;
    if (!state) return;
    this.choice.replaceChildren(...(state.models.length ? state.models : [state.model]).map((/** @type {string} */ name) =>
      element("option", { value: name }, MODELS[name] ?? `Polynomial of order ${name.slice(4)}`)));
    this.choice.value = state.models.length ? this.model : state.model;
    this.writeButton.hidden = !state.models.length;
    this.writeButton.textContent = state.written ? "Write the image again" : "Write the image on the map";
    this.writeButton.title = state.written ? `Replaces ${state.written}` : "";
    this.areaButton.textContent = this.area ? "Fit the whole image" : "Fit only the part shown";
    this.studio.tabs.count("control", state.points.length ? String(state.points.length) : "", state.messages.some((/** @type {any} */ one) => one.severity === "error"));
    this.#renderFigures();
    this.messages.replaceChildren(...state.messages.map((/** @type {any} */ one) => element("li", { class: `card ${one.severity === "error" ? "error" : "note"}` },
      element("p", {}, one.what), element("p", { class: "faint" }, one.hint),
      ...one.points.map((/** @type {string} */ name) => element("button", { onclick: () => this.select(name, true) }, `Show ${name}`)))));
    this.table.render(state.points);
    this.advice.render();
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

  /** Draw points, residuals, the expected place and the advice over both pictures. */
  draw() {
    drawControl(this);
  }

  /**
   * @param {string} name
   * @param {boolean} centre both pictures on it
   */
  select(name, centre) {
    this.selected = name;
    const point = this.chosen;
    if (centre && point) {
      this.panes.centre("image", [point.col, point.row], true);
      if (point.on_map && point.on_map[0] !== null) this.panes.centre("map", point.on_map, true);
    }
    this.table.mark(name);
    this.draw();
  }

  /** @param {boolean} on */
  follow(on) {
    this.followBox.checked = on;
    this.panes.follow(on);
  }

  /**
   * Change a point.
   * @param {any} point as it was told: when this is done another one may have its name
   * @param {any} values
   */
  async change({ id, col, row }, values) {
    await this.studio.attempt(() => this.ask("PATCH", `/points/${encodeURIComponent(id)}`, { ...values, was: [col, row] }));
  }

  /** @param {any} [point] as it was told */
  async remove(point = this.chosen) {
    if (!point) return;
    const { id, col, row } = point;
    await this.studio.attempt(async () => {
      await this.ask("DELETE", `/points/${encodeURIComponent(id)}`, { was: [col, row] });
      this.studio.say(`point ${id} taken out; Ctrl Z brings it back`);
    });
  }

  /** Fit only what the image pane shows, or the whole image again. */
  useArea() {
    if (this.area) this.area = null;
    else {
      const [left, bottom, right, top] = this.studio.imageView.map.getView().calculateExtent();
      this.area = [left, -top, right, -bottom];
    }
    this.advice.clear();
    this.load();
  }

  /** Write the image placed on the map. */
  async write() {
    await this.studio.attempt(async () => {
      const opened = this.studio.image?.id;
      if (!this.state) await this.load(); // the image was opened a moment ago
      if (!this.state || opened !== this.studio.image?.id) return this.studio.say("the points of the image are still being read", true);
      const address = `/api/control/${opened}/georeference?${this.query()}`, overwrite = Boolean(this.state.written);
      this.studio.say("the image is drawn on the map …");
      await editsMade();
      const made = await send("POST", address, { overwrite });
      await this.studio.load();
      await this.load();
      this.studio.say(`${made.file} written: ${made.model}, ${made.points} points, RMS ${shown(made.rms, 2)} px`);
    });
  }
}
