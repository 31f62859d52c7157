// Placing a point: by a click in each picture, where it is expected, or by measurement to a fraction of a pixel.

import { send } from "../api.js";
import { byId, element, shown } from "../dom.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

/** The point that is placed, or measured again. */
export class Placement {
  button = element("button", { id: "control-place", class: "primary", "aria-pressed": "false", onclick: () => this.start(!this.on) }, "New point (P)");
  hint = element("p", { class: "hint", id: "control-hint", "aria-live": "polite" });

  /** @param {any} control */
  constructor(control) {
    this.control = control;
    this.studio = control.studio;
    this.panes = control.panes;
    this.on = false;
    this.again = false; // the next click moves the selected point
    /** @type {Promise<any>} */
    this.measuring = Promise.resolve(); // what is measured, until the edit is made that comes of it
    /** @type {{image: number[] | null, map: number[] | null}} */
    this.draft = { image: null, map: null };
    /** @type {{image: number[] | null, map: number[] | null}} */
    this.expected = { image: null, map: null };
    for (const side of /** @type {("image" | "map")[]} */ (["image", "map"])) {
      this.panes.view(side).map.on("click", (/** @type {any} */ event) => this.#click(side, event));
    }
  }

  /**
   * Begin or leave a new point.
   * @param {boolean} on
   */
  start(on) {
    this.on = on;
    this.again = false;
    this.draft = { image: null, map: null };
    this.expected = { image: null, map: null };
    this.button.setAttribute("aria-pressed", String(on));
    this.hint.textContent = on ? "Click the point in the image and on the map, in either order, or move the cross by arrow keys and press Enter. E takes the expected place, M matches, C centres a mark, Esc leaves." : "";
    for (const view of [this.studio.imageView, this.studio.mapView]) {
      view.canvas.classList.toggle("placing", on);
      // OpenLayers takes two quick clicks for a double one, wherever they are.
      for (const one of view.map.getInteractions().getArray()) if (one instanceof ol.interaction.DoubleClickZoom) one.setActive(!on);
    }
    if (on && this.studio.mapView.home && byId("views").dataset.view !== "both") this.studio.chooseView("both");
    // Keys alone: the cross waits in the image. A pane that has the focus keeps it.
    if (on && !document.activeElement?.closest(".canvas")) this.studio.imageView.canvas.focus();
    for (const view of [this.studio.imageView, this.studio.mapView]) view.cursor.show();
    this.control.draw();
  }

  /** The next click moves the point that is chosen. */
  measureAgain() {
    const { selected } = this.control;
    if (!selected) return this.studio.say("choose a point first", true);
    this.start(false);
    this.again = true;
    this.hint.textContent = `Click where point ${selected} is, in the image or on the map; Esc leaves it.`;
    for (const view of [this.studio.imageView, this.studio.mapView]) view.cursor.show();
    return undefined;
  }

  /**
   * @param {"image" | "map"} side
   * @param {any} event
   */
  #click(side, event) {
    const { control } = this;
    if (!control.open || !this.panes.view(side).home) return;
    const [x, y] = event.coordinate;
    const at = side === "image" ? [x, -y] : [x, y];
    if (this.again && control.chosen) this.#moveSelected(side, at);
    else if (this.on) this.setHalf(side, at);
    else {
      const found = this.panes.pointAt(side, event.pixel);
      if (found) control.select(found, false);
    }
  }

  /**
   * One half of the point that is placed; the other half's expected place is shown.
   * @param {"image" | "map"} side
   * @param {number[]} at pixels of the image, or map coordinates
   */
  async setHalf(side, at) {
    const { draft } = this;
    draft[side] = at;
    const other = side === "image" ? "map" : "image";
    if (this.draft.image && this.draft.map) return this.#add();
    this.control.draw();
    // Keys alone go on in the other picture.
    if (this.panes.view(side).cursor.place) this.panes.view(other).canvas.focus();
    await this.studio.attempt(async () => {
      const place = await this.panes.expected(side, at);
      if (draft !== this.draft || draft[side] !== at) return;
      this.expected[other] = place;
      if (!place) return;
      this.panes.centre(other, place);
      this.panes.view(other).cursor.to(other === "image" ? [place[0], -place[1]] : place);
      this.control.draw();
    });
  }

  async #add() {
    const { draft } = this, { image, map } = draft;
    if (!image || !map) return;
    this.start(true);
    const next = this.draft;
    const state = await this.studio.attempt(() => this.control.ask("POST", "/points", { col: image[0], row: image[1], ...this.panes.onLayer(map) }));
    if (state) return this.studio.say(`point ${state.points.at(-1).id} measured`);
    if (next !== this.draft || next.image || next.map) return;
    this.draft = draft; // it was not saved: the next click corrects it
    this.control.draw();
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
  measure(way) {
    this.measuring = this.#measure(way);
  }

  /** @param {"match" | "mark"} way */
  async #measure(way) {
    const { control, draft, on } = this;
    const chosen = control.chosen;
    const opened = this.studio.image?.id;
    const half = draft.image;
    const image = /** @type {any} */ (this.draft.image) ?? this.expected.image ?? (chosen ? [chosen.col, chosen.row] : null);
    const map = this.draft.map ?? chosen?.on_map ?? null;
    if (way === "mark" && !image) return this.studio.say("click near the mark in the image first", true);
    if (way === "match" && !map) return this.studio.say("click the place on the map first", true);
    await this.studio.attempt(async () => {
      const body = way === "mark" ? { way, col: image[0], row: image[1] } : { way, ...this.panes.onLayer(map) };
      const found = await send("POST", `/api/control/${opened}/measure?${control.query()}`, body);
      if (opened !== this.studio.image?.id || (on && (draft !== this.draft || half !== draft.image))) return;
      this.studio.say(`${way === "match" ? "matched" : "centred"} at col ${shown(found.col, 2)}, row ${shown(found.row, 2)}, ± ${shown(found.sigma, 3)} px`);
      if (on) await this.setHalf("image", [found.col, found.row]);
      else if (chosen) await control.change(chosen, { col: found.col, row: found.row });
    });
  }

  /**
   * @param {string} side
   * @param {number[]} at
   */
  async #moveSelected(side, at) {
    this.again = false;
    this.hint.textContent = "";
    await this.studio.attempt(() => this.control.change(this.control.chosen, side === "image" ? { col: at[0], row: at[1] } : this.panes.onLayer(at)));
  }
}
