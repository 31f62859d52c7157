// What waits: edits that their GeoPackage does not have yet, and drawings that were not ended.

import { edit } from "../api.js";
import { element } from "../dom.js";

const WORDS = /** @type {Record<string, string>} */ ({ Point: "A point", LineString: "A line", Polygon: "An area" });

/** Cards of what waits. */
export class Waiting {
  list = element("ul", { class: "list", id: "features-waiting", "aria-label": "What waits to be saved", "aria-live": "polite" });

  /** @param {any} tool */
  constructor(tool) {
    this.tool = tool;
  }

  render() {
    const { overview } = this.tool;
    const edits = overview.pending.map((/** @type {any} */ one) => element("li", { class: "card error" },
      element("p", {}, `${one.title}: kept in the journal, not in ${one.file} yet`), element("p", {}, one.why ?? ""), element("p", { class: "faint" }, one.conflict ? "" : one.hint ?? ""),
      ...(one.conflict ? [this.#button("Save it over that", { act: "over", number: one.number }), this.#button("Drop it", { act: "drop", number: one.number })] : [this.#button("Try again", { act: "again" })])));
    const sketches = Object.entries(this.tool.sketch.going ? {} : overview.sketches).map(([key, drawn]) => element("li", { class: "card note" },
      element("p", {}, `${WORDS[drawn.kind] ?? "Something"} of ${drawn.coordinates.length} vertices was being drawn${drawn.side === "image" ? " in a photo" : ""}.`),
      element("button", { class: "primary", onclick: () => this.tool.studio.attempt(() => this.tool.sketch.resume(key, drawn)) }, "Go on with it"), " ",
      element("button", { onclick: () => this.#drop(key) }, "Drop it")));
    this.list.replaceChildren(...edits, ...sketches);
  }

  /**
   * @param {string} text
   * @param {any} act
   */
  #button(text, act) {
    return element("button", { onclick: () => this.tool.studio.attempt(async () => { await edit("POST", "/api/features/pending", act); await this.tool.load(); }) }, text);
  }

  /** @param {string} key */
  async #drop(key) {
    await this.tool.studio.attempt(async () => { await edit("PUT", "/api/features/sketch", { page: key, drawn: null }); await this.tool.load(); });
  }
}
