// The tab of sheets: a layout chosen, edited in a form and on its preview, and printed.

import { edit, editsMade, get, send } from "../api.js";
import { byId, element, firstThere } from "../dom.js";
import { LayoutForm } from "./form.js";
import { Stage } from "./stage.js";

/** Sheets of the project. */
export class SheetTool {
  /** @type {[string, string, () => void][]} */
  keys = [["+", "larger", () => this.zoom(1.5)], ["-", "smaller", () => this.zoom(1 / 1.5)], ["Arrows, Shift", "move the box that has the focus by 1 mm, by 5 mm", () => {}]];
  choice = /** @type {any} */ (element("select", { id: "sheet-layout", "aria-label": "Layout", onchange: () => { this.layout = this.choice.value; this.#nameThePrint(); this.load(); } }));
  raster = /** @type {any} */ (element("select", { id: "sheet-raster", "aria-label": "Raster of the sheet", onchange: () => this.draw() }));
  name = /** @type {any} */ (element("input", { type: "text", id: "sheet-name", placeholder: "name", "aria-label": "Name of a new layout" }));
  format = /** @type {any} */ (element("select", { id: "sheet-format", "aria-label": "Format", onchange: () => this.#nameThePrint() }, ...["pdf", "png", "tif"].map((one) => element("option", { value: one }, one === "tif" ? "GeoTIFF" : one.toUpperCase()))));
  printButton = element("button", { id: "sheet-print", class: "primary", disabled: true, onclick: () => this.print() }, "Print");
  stopButton = element("button", { id: "sheet-stop", hidden: true, onclick: () => this.studio.attempt(async () => this.showPrint(await send("POST", "/api/sheets/print/stop"))) }, "Stop");
  bar = element("progress", { id: "sheet-progress", hidden: true, "aria-label": "Progress of the print" });
  printed = element("p", { id: "sheet-printed", "aria-live": "polite" });
  message = element("div", { id: "sheet-message", "aria-live": "polite" });
  form = new LayoutForm((edits, title) => this.edit(edits, title));
  shown = false;
  layout = ""; // id of the layout that was chosen last; a file that is being written may be missing for a moment
  serial = 0; // of the last reading: what was read for an earlier one comes too late
  /** @type {any} */
  overview = null;
  /** @type {any} */
  state = null;
  printing = false;
  printSerial = 0; // of the print that is shown
  drawing = false;
  again = false;
  /** @type {any} */
  refused = null; // what was wrong with the last edit, until the next one

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    const view = byId("sheet-view");
    this.caption = /** @type {HTMLElement} */ (view.querySelector(".name"));
    this.place = /** @type {HTMLElement} */ (view.querySelector(".place"));
    this.stage = new Stage(/** @type {HTMLElement} */ (view.querySelector(".sheet-stage")), (name, position) => this.moveElement(name, position));
    const begin = element("form", { class: "tools" }, this.name, element("button", {}, "New layout"));
    begin.addEventListener("submit", (event) => {
      event.preventDefault();
      this.create();
    });
    studio.tabs.panel("sheet").append(
      element("div", { class: "tools" }, this.choice), begin, element("div", { class: "tools" }, element("label", { for: "sheet-raster" }, "of"), this.raster),
      element("div", { class: "tools" }, this.printButton, this.format, this.stopButton), this.bar, this.printed, this.message, this.form.place);
    studio.addEventListener("project", () => this.shown && this.load());
    for (const [id, factor] of [["sheet-larger", 1.5], ["sheet-smaller", 1 / 1.5]]) byId(String(id)).addEventListener("click", () => this.zoom(Number(factor)));
  }

  /** @param {boolean} on whether its tab is shown */
  show(on) {
    document.body.dataset.tool = on ? "sheet" : "";
    byId("sheet-view").hidden = !on;
    if (on && !this.shown) this.load();
    this.shown = on;
  }

  /** @param {number} factor */
  zoom(factor) {
    this.stage.zoomBy(factor);
    this.draw();
  }

  /** Read the layouts of the project, and that which is chosen, anew. */
  async load() {
    const serial = ++this.serial;
    await this.studio.attempt(async () => {
      const overview = await get("/api/sheets");
      if (serial !== this.serial) return;
      this.overview = overview;
      const { layouts, rasters } = overview;
      const layout = firstThere([this.layout, this.state?.id], layouts), raster = this.raster.value;
      this.choice.replaceChildren(...layouts.map((/** @type {any} */ one) => element("option", { value: one.id }, one.name)));
      this.raster.replaceChildren(...rasters.map((/** @type {any} */ one) => element("option", { value: one.id }, `${one.name} (${one.role})`)));
      this.raster.value = firstThere([raster], rasters);
      this.choice.value = layout;
      this.#nameThePrint();
      this.choice.hidden = !layout;
      const state = layout ? await get(`/api/sheets/${layout}`) : null;
      if (serial !== this.serial) return;
      this.showState(state);
      this.showPrint(overview.print);
      await this.draw();
    });
  }

  async create() {
    await this.studio.attempt(async () => {
      const made = await edit("POST", "/api/sheets", { name: this.name.value });
      this.name.value = "";
      this.layout = made.id;
      this.studio.showHistory(made.history);
      this.studio.say(`${made.name} was begun`);
      await this.load();
    });
  }

  /** @param {any} state of a layout; null where there is none */
  showState(state) {
    if (state?.id !== this.state?.id) {
      this.stage.clear(); // what is moved in a sheet is of its layout
      this.refused = null;
    }
    this.state = state;
    this.caption.textContent = state?.name ?? "No layout yet";
    if (state) this.form.show(this.overview.form, state, this.overview.vectors);
    else {
      this.place.textContent = "";
      this.form.empty("The project has no layout of a sheet yet. Give a name and press New layout.");
    }
    this.#nameThePrint();
    this.tell(state?.error);
  }

  /**
   * @param {any[]} edits
   * @param {string} title for the history
   */
  async edit(edits, title) {
    try {
      const { history } = await edit("PATCH", `/api/sheets/${this.state.id}`, { edits, title });
      this.refused = null;
      this.studio.say(title);
      this.studio.showHistory(history);
      this.load();
    } catch (error) {
      const said = /** @type {any} */ (error);
      this.refused = said.said ?? { what: said.message, where: "", hint: "" };
      this.tell(null);
      this.studio.say(said.message, true);
    }
  }

  /**
   * @param {string} name of an element
   * @param {[number, number] | null} position null for its usual place
   */
  moveElement(name, position) {
    for (const { table, keys } of this.overview.form) {
      const field = keys.find((/** @type {any} */ one) => one.position === name);
      if (field) this.edit([{ table, key: field.key, value: position }], position ? `${name} moved` : `${name} in its usual place`);
    }
  }

  /** Draw the preview; where it is asked for again meanwhile, once more after that. */
  async draw() {
    if (this.drawing) {
      this.again = true;
      return;
    }
    this.drawing = true;
    do {
      this.again = false;
      await this.studio.attempt(() => this.#draw());
    } while (this.again);
    this.drawing = false;
  }

  async #draw() {
    if (!this.state || this.state.error) return;
    if (!this.raster.value) {
      this.tell({ what: "there is no mosaic, ortho or reference yet to make a sheet of", where: "", hint: "run the mosaic: see Steps" });
      return;
    }
    this.place.textContent = "drawing …";
    const { dpi } = this.stage, { id } = this.state;
    const found = await get(`/api/sheets/${id}/preview?raster=${this.raster.value}&dpi=${dpi}`);
    if (this.again || this.state?.id !== id) return;
    this.place.textContent = "";
    this.tell(found.error, found.notes);
    if (found.error || !(await this.stage.show(found.sheet, `/api/sheets/pictures/${found.key}.png`))) return;
    const { width, height, scale } = found.sheet;
    this.place.textContent = `1 : ${scale.toLocaleString("en").replaceAll(",", "\u202f")} on ${width} × ${height} mm`;
    if (this.stage.dpi > dpi) this.again = true; // the paper was not known before the first picture
  }

  /**
   * What is wrong with the layout, above the form and at its field, and notes on the sheet.
   * @param {any} error
   * @param {string[]} [notes]
   */
  tell(error, notes = []) {
    error ??= this.refused;
    const card = (/** @type {string} */ kind, /** @type {(string | null)[]} */ lines) => element("div", { class: `card ${kind}` }, ...lines.filter(Boolean).map((line) => element("p", {}, line)));
    this.message.replaceChildren(...(error ? [card("error", [error.where ? `${error.where}: ${error.what}` : error.what, error.hint])] : []), ...notes.map((note) => card("note", [note])));
    this.form.tell(error);
  }

  async print() {
    const { id, prints } = this.state, raster = this.raster.value, format = this.format.value;
    this.stage.settle();
    await this.studio.attempt(async () => {
      await editsMade();
      this.showPrint(await send("POST", `/api/sheets/${id}/print`, { raster, format, overwrite: prints.includes(format) }));
    });
  }

  /** What was moved a moment ago is saved first, and taken back. */
  takeBack() {
    this.stage.settle();
    return false;
  }

  #nameThePrint() {
    const there = this.state?.prints.includes(this.format.value);
    const missing = !this.state ? "There is no layout to print yet" : this.choice.value !== this.state.id ? "The layout is still being read" : !this.raster.value ? "There is no mosaic, ortho or reference to print yet" : "";
    this.printButton.textContent = there ? "Print again" : "Print";
    this.printButton.title = missing || (there ? "Replaces the file of the last print" : "");
    this.printButton.toggleAttribute("disabled", this.printing || missing !== "");
  }

  /** @param {any} print as the server tells it; null where there was none */
  showPrint(print) {
    if (print && print.serial < this.printSerial) return; // an event was faster than the answer
    this.printSerial = print?.serial ?? 0;
    const active = print?.state === "running";
    this.printing = active;
    this.stopButton.hidden = !active;
    this.bar.hidden = !active;
    if (print?.total) {
      this.bar.setAttribute("max", String(print.total));
      this.bar.setAttribute("value", String(print.done));
    }
    const error = print && [print.where, print.what].filter(Boolean).join(": ") + (print.hint ? `; ${print.hint}` : "");
    this.printed.textContent = !print ? "" : active ? `printing: ${print.stage} …` : print.state === "done" ? `printed: ${print.file}` : error;
    this.printed.className = print?.state === "done" ? "good" : print?.state === "failed" ? "bad" : "";
    if (print?.state === "done" && print.layout === this.state?.id && !this.state.prints.includes(print.output.split(".").at(-1))) {
      this.state.prints.push(print.output.split(".").at(-1));
    }
    this.#nameThePrint();
  }
}
