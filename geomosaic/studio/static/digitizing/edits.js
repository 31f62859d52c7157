// Edits: features drawn, moved, deleted, and their attributes, each saved at once.

import { send } from "../api.js";
import { vertices } from "./side.js";

/** Edits of the layer that is open. */
export class Edits {
  /** @param {any} tool */
  constructor(tool) {
    this.tool = tool;
  }

  /**
   * Save what was drawn; where that fails the drawing stays.
   * @param {any} side
   * @param {string} kind
   * @param {any} geometry
   */
  async finish(side, kind, geometry) {
    const { sketch } = this.tool, key = sketch.leave();
    const place = this.#place(side); // while it is saved another image may be opened
    const places = kind === "Polygon" ? geometry.getCoordinates()[0].slice(0, -1) : kind === "LineString" ? geometry.getCoordinates() : [];
    await sketch.sending;
    const made = await this.tool.studio.attempt(() => this.#edit(place, [{ id: null, geometry: side.write(geometry) }], key));
    if (made) {
      this.tool.selected = made.ids[0];
      this.tool.form.waiting = side.view.canvas;
      await this.tool.load();
    } else if (places.length && !sketch.going) {
      sketch.key = key;
      if (this.tool.mode !== "draw") this.tool.setMode("draw");
      side.extend(places.map((/** @type {number[]} */ at) => side.place(at)));
    }
  }

  /**
   * Save the features that were moved.
   * @param {any} side
   */
  async reshape(side) {
    const known = new Map(this.tool.layer.features.map((/** @type {any} */ one) => [one.id, one]));
    const changes = side.source.getFeatures().flatMap((/** @type {any} */ one) => {
      const before = known.get(one.getId());
      const same = before && JSON.stringify(vertices(one.getGeometry())) === JSON.stringify(vertices(side.read(before[side.name])));
      return same ? [] : [{ id: one.getId(), stamp: one.get("stamp"), geometry: side.write(one.getGeometry()) }];
    });
    if (changes.length) await this.tool.studio.attempt(() => this.#edit(this.#place(side), changes));
    await this.tool.load();
  }

  /**
   * Change attributes of the chosen feature.
   * @param {Record<string, any>} values
   */
  async setValues(values) {
    const { chosen } = this.tool;
    if (!chosen) return;
    await this.tool.studio.attempt(() => this.#edit(this.#place(this.tool.map), [{ id: chosen.id, stamp: chosen.stamp, values }]));
    await this.tool.load();
  }

  /** Delete the chosen feature. */
  async remove() {
    const { chosen } = this.tool;
    if (!chosen) return this.tool.studio.say("choose a feature first", true);
    await this.tool.studio.attempt(() => this.#edit(this.#place(this.tool.map), [{ id: chosen.id, stamp: chosen.stamp, remove: true }]));
    return this.tool.load();
  }

  /**
   * Layer that is open, and the picture whose coordinates changes have.
   * @param {any} side
   */
  #place(side) {
    return { layer: this.tool.layerId, picture: side.name === "image" ? { image: this.tool.studio.image.id } : { map_layer: this.tool.mapId } };
  }

  /**
   * @param {{layer: string, picture: any}} place
   * @param {any[]} changes
   * @param {string} [page] key of the sketch that is saved with them
   */
  async #edit({ layer, picture }, changes, page) {
    const made = await send("POST", `/api/features/layers/${layer}/edits`, { changes, ...picture, shared: this.tool.sharedBox.checked, page });
    this.tool.studio.say([made.title, ...made.notes].join("; "), made.notes.length > 0);
    return made;
  }
}
