// The sheet as it will be printed, with boxes around what can be moved.

import { element } from "../dom.js";

const NAMES = /** @type {Record<string, string>} */ ({
  title: "Title", number: "Sheet number", logo: "Logo", legend: "Legend", scalebar: "Scale bar", north: "North arrows", notes: "Notes",
});
const ARROWS = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] });
// Milliseconds after the last arrow key until a move is saved: a burst of keys is one edit.
const PAUSE = 500;

/** Picture of a page in which elements are moved. */
export class Stage {
  picture = /** @type {HTMLImageElement} */ (element("img", { alt: "Preview of the sheet" }));
  page = element("div", { class: "sheet-page" }, this.picture);
  zoom = 1;
  serial = 0; // of the picture that is asked for
  fit = 1; // scale of the last sheet without zoom
  settle = () => {}; // save what arrow keys have moved
  /** @type {any} */
  sheet = null;
  /** @type {Map<string, HTMLElement>} */
  boxes = new Map();

  /**
   * @param {HTMLElement} place
   * @param {(name: string, position: [number, number] | null) => void} move saves the place of an element in mm from the left and the upper edge
   */
  constructor(place, move) {
    this.place = place;
    this.move = move;
    place.append(this.page);
    new ResizeObserver(() => this.#size()).observe(place);
  }

  /** Pixels of the screen for a millimetre of paper. */
  get scale() {
    if (this.sheet) {
      const [left, bottom, right, top] = this.sheet.paper;
      this.fit = Math.max(0.3, Math.min((this.place.clientWidth - 32) / (right - left), (this.place.clientHeight - 32) / (top - bottom)));
    }
    return this.fit * this.zoom;
  }

  /** Resolution that the screen shows, in steps so that a small change of the window needs no new picture. */
  get dpi() {
    return Math.max(72, 24 * Math.ceil((this.scale * 25.4 * devicePixelRatio) / 24));
  }

  /**
   * @param {any} sheet page and boxes of elements, mm from the lower left corner
   * @param {string} address of its picture
   * @returns {Promise<boolean>} whether it is shown; another one may have been asked for meanwhile
   */
  async show(sheet, address) {
    const next = new Image(), serial = ++this.serial;
    next.src = address;
    await next.decode();
    if (serial !== this.serial) return false;
    this.sheet = sheet;
    this.picture.src = address;
    for (const [name, box] of this.boxes) {
      if (!(name in sheet.elements)) {
        box.remove();
        this.boxes.delete(name);
      }
    }
    for (const name of Object.keys(sheet.elements)) {
      if (!this.boxes.has(name)) this.boxes.set(name, this.#box(name));
    }
    this.#size();
    return true;
  }

  /** Show nothing. */
  clear() {
    this.settle();
    this.serial += 1;
    this.sheet = null;
    this.picture.removeAttribute("src");
    for (const box of this.boxes.values()) box.remove();
    this.boxes.clear();
    this.page.style.width = this.page.style.height = "0";
  }

  /** @param {number} factor */
  zoomBy(factor) {
    this.zoom = Math.min(6, Math.max(1, this.zoom * factor));
    this.#size();
  }

  #size() {
    if (!this.sheet) return;
    const [left, bottom, right, top] = this.sheet.paper;
    this.page.style.width = `${(right - left) * this.scale}px`;
    this.page.style.height = `${(top - bottom) * this.scale}px`;
    for (const [name, box] of this.boxes) if (!box.dataset.moving) this.#place(name, this.positionOf(name));
  }

  /**
   * Upper left corner of an element, mm from the left and the upper edge of the paper.
   * @param {string} name
   * @returns {[number, number]}
   */
  positionOf(name) {
    const [left, , , top] = this.sheet.elements[name];
    return [left, this.sheet.height - top];
  }

  /**
   * @param {string} name
   * @param {[number, number]} position
   */
  #place(name, position) {
    const [left, bottom, right, top] = this.sheet.elements[name];
    const box = /** @type {HTMLElement} */ (this.boxes.get(name));
    const [paperLeft, , , paperTop] = this.sheet.paper;
    box.style.left = `${(position[0] - paperLeft) * this.scale}px`;
    box.style.top = `${(position[1] + paperTop - this.sheet.height) * this.scale}px`;
    box.style.width = `${(right - left) * this.scale}px`;
    box.style.height = `${(top - bottom) * this.scale}px`;
    const words = `${NAMES[name] ?? name}, ${position[0].toFixed(1)} mm from the left, ${position[1].toFixed(1)} mm from the top`;
    box.setAttribute("aria-label", `${words}. Arrow keys move it, Delete puts it in its usual place`);
    box.title = words;
  }

  /**
   * Place inside the paper that is nearest to one, on tenths of a millimetre.
   * @param {string} name
   * @param {[number, number]} position
   * @returns {[number, number]}
   */
  #inside(name, position) {
    const [left, bottom, right, top] = this.sheet.elements[name];
    const most = [Math.max(0, this.sheet.width - (right - left)), Math.max(0, this.sheet.height - (top - bottom))];
    return /** @type {[number, number]} */ (position.map((value, k) => Math.round(10 * Math.min(Math.max(value, 0), most[k])) / 10));
  }

  /** @param {string} name */
  #box(name) {
    const box = element("button", { class: "sheet-box", "data-element": name }, element("span", { "aria-hidden": "true" }, NAMES[name] ?? name));
    /** @type {[number, number]} */
    let at = [0, 0];
    let waiting = 0;
    const start = () => {
      if (!box.dataset.moving) at = this.positionOf(name);
      box.dataset.moving = "1";
    };
    const end = () => {
      delete box.dataset.moving;
      if (!this.boxes.has(name)) return undefined; // the sheet has it no longer
      const before = this.positionOf(name);
      if (Math.hypot(at[0] - before[0], at[1] - before[1]) < 0.05) return this.#place(name, before);
      // Until the new picture is there, the box stays where it was put.
      const [left, bottom, right, top] = this.sheet.elements[name];
      const low = this.sheet.height - at[1];
      this.sheet.elements[name] = [at[0], low - (top - bottom), at[0] + right - left, low];
      return this.move(name, at);
    };
    const settle = () => {
      clearTimeout(waiting);
      this.settle = () => {};
      end();
    };
    box.addEventListener("blur", () => this.settle());
    box.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => {
      if (event.button) return;
      start();
      box.focus();
      box.setPointerCapture(event.pointerId);
      const from = [event.clientX, event.clientY];
      const origin = at;
      const drag = (/** @type {PointerEvent} */ moved) => {
        at = this.#inside(name, [origin[0] + (moved.clientX - from[0]) / this.scale, origin[1] + (moved.clientY - from[1]) / this.scale]);
        this.#place(name, at);
      };
      const stop = () => {
        box.removeEventListener("pointermove", drag);
        end();
      };
      box.addEventListener("pointermove", drag);
      box.addEventListener("lostpointercapture", stop, { once: true });
      event.preventDefault();
    });
    box.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      const step = ARROWS[event.key];
      if (step) {
        start();
        const far = event.shiftKey ? 5 : 1;
        at = this.#inside(name, [at[0] + far * step[0], at[1] + far * step[1]]);
        this.#place(name, at);
        clearTimeout(waiting);
        waiting = setTimeout(settle, PAUSE);
        this.settle = settle;
      } else if (event.key === "Delete" || event.key === "Backspace") {
        this.settle();
        this.move(name, null);
      } else return;
      event.preventDefault();
      event.stopPropagation();
    });
    this.page.append(box);
    return box;
  }
}
