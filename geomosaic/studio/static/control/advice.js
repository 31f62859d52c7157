// Advice of the next point: the order of places, and what the error over the image would be.

import { get } from "../api.js";
import { byId, element, shown } from "../dom.js";

/** Where one more point helps most. */
export class Advice {
  list = element("div", { id: "control-order" });

  /** @param {any} control */
  constructor(control) {
    this.control = control;
    /** @type {any} */
    this.facts = null; // as the server told them; null while nothing is asked for
    this.asked = 0;
  }

  clear() {
    this.asked += 1;
    this.facts = null;
  }

  /** Ask, and draw it; once more takes it away. */
  async toggle() {
    const { control } = this;
    if (this.facts) {
      this.clear();
      control.render();
      return;
    }
    if (!control.state) return control.studio.say("the points of the image are still being read", true);
    const asked = ++this.asked;
    await control.studio.attempt(async () => {
      const facts = await get(`/api/control/${control.studio.image.id}/next?${control.query()}`);
      if (asked !== this.asked) return;
      this.facts = facts;
      if (!control.area) control.studio.imageView.fit();
      if (byId("views").dataset.view === "map") control.studio.chooseView("both");
      control.render();
    });
  }

  render() {
    const { facts } = this;
    if (!facts) return this.list.replaceChildren();
    const { control } = this;
    const unit = facts.unit;
    const digits = facts.rms < 0.1 ? 3 : facts.rms < 10 ? 2 : 0;
    const rows = facts.order.slice(0, 8).map((/** @type {any} */ one, /** @type {number} */ i) => element("li", {},
      element("button", { class: "row", onclick: () => this.#goTo(one) }, element("strong", {}, String(i + 1)),
        element("span", { class: "words" }, element("span", {}, one.id ? `point ${one.id}` : `col ${shown(one.col, 0)}, row ${shown(one.row, 0)}`),
          element("small", {}, `expected error then ${shown(one.rms, digits)} ${unit}`)))));
    this.list.replaceChildren(element("p", {}, element("strong", {}, "Next point"), ` expected error now ${shown(facts.rms, digits)} ${unit} RMS over the ${control.area ? "part" : "image"}${facts.of_block ? ", as the block was adjusted and with the points since" : ""}; in the image, what it would be with one more point there: `,
      element("span", { class: "ramp" }, "less"), " to ", element("span", { class: "ramp far" }, "as now")), element("ol", { class: "list" }, ...rows));
  }

  /** Ask where nothing was asked yet, and go to the best place. */
  async goToFirst() {
    if (!this.facts) await this.toggle();
    if (this.facts?.order.length) await this.#goTo(this.facts.order[0]);
  }

  /** @param {any} one of the order */
  async #goTo(one) {
    const { panes, studio } = this.control, serial = ++panes.serial;
    panes.centre("image", [one.col, one.row], true);
    studio.imageView.cursor.to([one.col, -one.row]);
    await studio.attempt(async () => {
      const there = await panes.expected("image", [one.col, one.row]);
      if (there && serial === panes.serial) panes.centre("map", there, true);
    });
  }
}
