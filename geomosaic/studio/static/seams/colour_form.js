// Colours of one photo: a gain and an offset on top of the balance, saved in the project file.

import { element } from "../dom.js";

/** Form of a photo's colours. */
export class ColourForm {
  choice = /** @type {HTMLSelectElement} */ (element("select", { id: "seams-image", onchange: () => this.#fill() }));
  gain = /** @type {HTMLInputElement} */ (element("input", { type: "number", id: "seams-gain", step: 0.01, min: 0.01, max: 100 }));
  offset = /** @type {HTMLInputElement} */ (element("input", { type: "number", id: "seams-offset", step: 1 }));
  box = element("form", { id: "seams-colours", onsubmit: (/** @type {Event} */ event) => this.#send(event) },
    element("h3", {}, "Colours of one photo"),
    element("div", { class: "field" }, element("label", { for: "seams-image" }, "Photo"), this.choice),
    element("div", { class: "field" }, element("label", { for: "seams-gain" }, "Gain"), this.gain),
    element("div", { class: "field" }, element("label", { for: "seams-offset" }, "Offset"), this.offset),
    element("div", { class: "tools" }, element("button", { type: "submit" }, "Apply"), element("button", { type: "button", onclick: () => this.#reset() }, "As balanced")));
  /** @type {any[]} */
  images = [];
  filled = ""; // name of the photo whose numbers are in the form

  /** @param {any} seams the tab */
  constructor(seams) {
    this.seams = seams;
  }

  /** @param {any[]} images with gain and offset */
  show(images) {
    const before = this.choice.value;
    this.images = images;
    this.box.hidden = !images.length;
    this.choice.replaceChildren(...images.map((one) => element("option", { value: one.name }, one.gain === 1 && one.offset === 0 ? one.name : `${one.name} *`)));
    this.choose(images.some((one) => one.name === before) ? before : images[0]?.name ?? "");
  }

  /** @param {string} name of a photo */
  choose(name) {
    this.choice.value = name;
    this.#fill();
  }

  #fill() {
    const own = this.images.find((one) => one.name === this.choice.value);
    if (!own || own.name === this.filled && this.box.contains(document.activeElement) && document.activeElement !== this.choice) return; // what is typed stays
    this.filled = own.name;
    this.gain.value = String(own.gain);
    this.offset.value = String(own.offset);
  }

  /** @param {Event} event */
  #send(event) {
    event.preventDefault();
    this.seams.retouch(this.choice.value, this.gain.valueAsNumber, this.offset.valueAsNumber);
  }

  #reset() {
    this.gain.value = "1";
    this.offset.value = "0";
    this.seams.retouch(this.choice.value, 1, 0);
  }
}
