// Keyboard cursor of a pane: a cross that is the pointer of the keyboard. Arrow keys move it and Enter clicks with it, or
// takes hold and drops; OpenLayers and the tools receive the pointer's own events, so that both ways of working are one.

import { element } from "./dom.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

// Pixels of the screen that an arrow key goes, alone and with Shift; pixels along the border where the picture moves on.
const STEP = 20, FINE = 1, BORDER = 24;
const ARROWS = /** @type {Record<string, number[]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] });
const ZOOMS = /** @type {Record<string, number>} */ ({ "+": 1, "-": -1 });

/** Cross of one pane. */
export class KeyboardCursor {
  /**
   * @param {any} view pane
   * @param {() => any} tool of the tab that is shown: `awaits(view)` while it waits for a place, `holds` while places are dragged
   * @param {(text: string) => void} say
   */
  constructor(view, tool, say) {
    this.view = view;
    this.tool = tool;
    this.say = say;
    this.held = false;
    this.cross = new ol.Overlay({ element: element("div", { class: "cursor", "aria-hidden": "true" }), positioning: "center-center", stopEvent: false });
    view.map.addOverlay(this.cross);
    // Before OpenLayers, whose arrow keys move the picture.
    view.canvas.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.#key(event), true);
    view.canvas.addEventListener("focus", () => this.show());
    view.canvas.addEventListener("blur", () => this.hide());
    view.canvas.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => event.isTrusted && this.hide());
  }

  /** Whether a tool waits for a place in this pane. */
  get wanted() {
    return Boolean(this.view.home && this.tool()?.awaits?.(this.view));
  }

  /** @returns {number[] | undefined} where the cross is, undefined where it is not in use */
  get place() {
    return this.cross.getPosition();
  }

  /** Show the cross where the keyboard has come to the pane and a tool waits: in the middle unless it has a place. */
  show() {
    if (!this.wanted || !this.view.canvas.matches(":focus-visible")) this.hide();
    else if (!this.place) this.#to(this.view.map.getView().getCenter(), false); // what was said last stays
  }

  hide() {
    this.#release();
    this.cross.setPosition(undefined);
  }

  /** @param {number[]} coordinate of the pane's map to go to, where the cross is in use */
  to(coordinate) {
    if (this.wanted && document.activeElement === this.view.canvas) this.#to(coordinate);
  }

  /**
   * @param {number[]} coordinate
   * @param {boolean} [aloud] whether the page says where that is
   */
  #to(coordinate, aloud = true) {
    this.cross.setPosition(coordinate);
    this.view.map.renderSync(); // after which the coordinate has its pixel
    this.#point("pointermove");
    this.view.tellPlace(coordinate);
    if (aloud) this.say(this.view.place.textContent ?? "");
  }

  /**
   * @param {string} type of the pointer's event at the cross
   * @param {boolean} [altKey]
   */
  #point(type, altKey = false) {
    const [x, y] = this.view.map.getPixelFromCoordinate(this.place);
    const viewport = this.view.map.getViewport();
    const { left, top } = viewport.getBoundingClientRect();
    const moves = type === "pointermove";
    // A move bubbles to the document only while the pointer is held: a pane that is just clicked would take it for a drag.
    viewport.dispatchEvent(new PointerEvent(type, {
      clientX: left + x, clientY: top + y, button: moves ? -1 : 0, buttons: type === "pointerdown" || (moves && this.held) ? 1 : 0,
      pointerId: 1, pointerType: "mouse", isPrimary: true, bubbles: !moves || this.held, cancelable: true, altKey,
    }));
  }

  /** @param {boolean} on whether a pointer that is held moves the picture, as without the keyboard */
  #panning(on) {
    for (const one of this.view.map.getInteractions().getArray()) if (one instanceof ol.interaction.DragPan) one.setActive(on);
  }

  /** @param {boolean} alt */
  #click(alt) {
    if (this.held) return this.#release();
    const holds = this.tool().holds && !alt;
    if (holds) this.#panning(false);
    this.#point("pointerdown", alt);
    if (holds) this.held = true;
    else this.#point("pointerup", alt);
    return undefined;
  }

  #release() {
    if (!this.held) return;
    this.held = false;
    this.#point("pointerup");
    this.#panning(true);
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (!this.wanted || event.ctrlKey || event.metaKey || (event.altKey && event.key !== "Enter")) return;
    const arrow = ARROWS[event.key];
    const at = this.place;
    // Without a cross, Enter is the tool's and the picture zooms about its middle.
    if (!arrow && !(at && (event.key === "Enter" || event.key in ZOOMS))) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    const { map } = this.view;
    const view = map.getView();
    if (!at) return this.#to(view.getCenter());
    if (event.key === "Enter") return event.repeat ? undefined : this.#click(event.altKey);
    if (!arrow) return view.adjustZoom(ZOOMS[event.key], at);
    const pixel = map.getPixelFromCoordinate(at) ?? map.getSize().map((/** @type {number} */ side) => side / 2);
    const step = event.shiftKey ? FINE : STEP;
    const resolution = view.getResolution();
    const moved = [at[0] + step * arrow[0] * resolution, at[1] - step * arrow[1] * resolution];
    const size = map.getSize();
    const out = arrow.some((way, axis) => way && (way < 0 ? pixel[axis] - step < BORDER : pixel[axis] + step > size[axis] - BORDER));
    if (out) view.setCenter(view.getCenter().map((/** @type {number} */ value, /** @type {number} */ axis) => value + moved[axis] - at[axis]));
    return this.#to(moved);
  }
}
