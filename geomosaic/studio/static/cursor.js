// Keyboard cursor of a pane: a cross that arrow keys move and Enter clicks with, while a tool waits for a place.

import { element } from "./dom.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

// Pixels of the screen that an arrow key goes, alone and with Shift; pixels along the border where the picture moves on.
const STEP = 20, FINE = 1, BORDER = 24;
const ARROWS = /** @type {Record<string, number[]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] });

/** Cross of one pane. */
export class KeyboardCursor {
  /**
   * @param {any} view pane
   * @param {() => boolean} wanted whether a tool waits for a place
   * @param {(text: string) => void} say
   */
  constructor(view, wanted, say) {
    this.view = view;
    this.wanted = wanted;
    this.say = say;
    this.cross = new ol.Overlay({ element: element("div", { class: "cursor", "aria-hidden": "true" }), positioning: "center-center", stopEvent: false });
    view.map.addOverlay(this.cross);
    // Before OpenLayers, whose arrow keys move the picture.
    view.canvas.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.#key(event), true);
    view.canvas.addEventListener("focus", () => this.show());
    view.canvas.addEventListener("blur", () => this.cross.setPosition(undefined));
    view.canvas.addEventListener("pointermove", () => this.cross.setPosition(undefined));
  }

  /** Show the cross where the keyboard has come to the pane and a tool waits: in the middle unless it has a place. */
  show() {
    const wanted = this.wanted() && this.view.home && this.view.canvas.matches(":focus-visible");
    if (!wanted) this.cross.setPosition(undefined);
    else if (!this.cross.getPosition()) this.#to(this.view.map.getView().getCenter());
  }

  /** @param {number[]} coordinate of the pane's map to go to, where the cross is in use */
  to(coordinate) {
    if (this.wanted() && document.activeElement === this.view.canvas) this.#to(coordinate);
  }

  /** @param {number[]} coordinate */
  #to(coordinate) {
    this.cross.setPosition(coordinate);
    this.view.tellPlace(coordinate);
    this.say(this.view.place.textContent ?? "");
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (!this.wanted() || !this.view.home || event.ctrlKey || event.altKey || event.metaKey) return;
    const arrow = ARROWS[event.key];
    if (!arrow && event.key !== "Enter") return;
    event.preventDefault();
    event.stopImmediatePropagation();
    const { map } = this.view;
    const at = this.cross.getPosition();
    if (!at) return this.#to(map.getView().getCenter());
    const pixel = map.getPixelFromCoordinate(at) ?? map.getSize().map((/** @type {number} */ side) => side / 2);
    if (!arrow) return map.dispatchEvent({ type: "click", coordinate: at, pixel });
    const step = event.shiftKey ? FINE : STEP;
    const resolution = map.getView().getResolution();
    const moved = [at[0] + step * arrow[0] * resolution, at[1] - step * arrow[1] * resolution];
    const size = map.getSize();
    const out = arrow.some((way, axis) => way && (way < 0 ? pixel[axis] - step < BORDER : pixel[axis] + step > size[axis] - BORDER));
    if (out) map.getView().setCenter(map.getView().getCenter().map((/** @type {number} */ value, /** @type {number} */ axis) => value + moved[axis] - at[axis]));
    return this.#to(moved);
  }
}
