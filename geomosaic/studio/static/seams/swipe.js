// Swipe: the mosaic before the last run left of a line, and as it is right of it.

import { element } from "../dom.js";
import { clipped } from "./clip.js";

/** Swipe over the map, with a slider for pointer and keys. */
export class Swipe {
  button = element("button", { id: "seams-swipe", "aria-pressed": "false", onclick: () => this.show(!this.on) }, "Before | after (W)");
  slider = /** @type {HTMLInputElement} */ (element("input", { type: "range", id: "seams-slider", min: 0, max: 1000, "aria-label": "Line between before and after", oninput: () => this.draw() }));
  line = element("div", { class: "swipe", hidden: true }, element("span", {}, "before"), element("span", {}, "after"));
  on = false;
  /** @type {any} */
  layer = null;

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    this.view = studio.mapView;
    this.slider.value = "500";
    this.slider.hidden = true;
    this.view.canvas.append(this.line, this.slider);
    studio.addEventListener("map", () => this.take());
    this.view.map.on("change:size", () => this.draw());
  }

  /** Take the layer of the mosaic before. */
  take() {
    const found = this.studio.entries.find((/** @type {any} */ one) => one.layer.role === "before")?.drawn ?? null;
    if (found && found !== this.layer) {
      clipped(found, () => {
        if (!this.on) return null;
        const [width, height] = this.view.map.getSize();
        const x = (width * Number(this.slider.value)) / 1000;
        return [[0, 0], [x, 0], [x, height], [0, height]];
      });
    }
    this.layer = found;
    this.button.toggleAttribute("disabled", !found);
    this.button.title = found ? "Left of the line the mosaic before the last run, right of it as it is" : "There is nothing to compare with before a run";
    if (this.on) this.show(Boolean(found));
  }

  /** @param {boolean} on */
  show(on) {
    if (on && !this.layer) return;
    this.on = on;
    this.button.setAttribute("aria-pressed", String(on));
    this.slider.hidden = !on;
    this.line.hidden = !on;
    this.layer?.setVisible(on);
    this.draw();
  }

  draw() {
    this.line.style.left = `${Number(this.slider.value) / 10}%`;
    this.layer?.changed();
  }
}
