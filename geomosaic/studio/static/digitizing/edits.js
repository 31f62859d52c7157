// Edits: features drawn, moved, deleted, and their attributes, each saved at once.

import { edit } from "../api.js";
import { vertices } from "./side.js";

/** Edits of the layer that is open. */
export class Edits {
  made = NaN; // id of the feature that was drawn last, and chosen with that
  /** @type {Map<string, string>} stamps of features after edits of this page, by those before: what is done until the features are read anew is done to those */
  after = new Map();

  /** @param {any} tool */
  constructor(tool) {
    this.tool = tool;
  }

  /** Forget edits, with which the features have been read. */
  forget() {
    this.after.clear();
  }

  /**
   * Save what was drawn; where that fails the drawing stays, or waits where something else is open now.
   * @param {any} side
   * @param {string} kind
   * @param {any} geometry
   */
  async finish(side, kind, geometry) {
    const { tool } = this, { sketch, selected } = tool, key = sketch.leave();
    const place = this.#place(side); // while it is saved another image may be opened
    const places = kind === "Polygon" ? geometry.getCoordinates()[0].slice(0, -1) : kind === "LineString" ? geometry.getCoordinates() : [];
    const made = await this.#edit(place, [{ id: null, geometry: side.write(geometry) }], key);
    if (made && place.layer === tool.choice.value && [selected, this.made].includes(tool.selected)) {
      tool.selected = this.made = made.ids[0];
      if (!sketch.going) tool.form.waiting = side.view.canvas;
    }
    if (!made && places.length && !sketch.going && tool.open && JSON.stringify(place) === JSON.stringify(this.#place(side))) {
      sketch.key = key;
      if (tool.mode !== "draw") tool.setMode("draw");
      side.extend(places.map((/** @type {number[]} */ at) => side.place(at)));
    }
    await tool.load();
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
    for (const one of changes) known.get(one.id)[side.name] = one.geometry; // what is moved next is told from this
    if (changes.length) await this.#edit(this.#place(side), changes);
    await this.tool.load();
  }

  /**
   * Change attributes of a feature.
   * @param {any} feature
   * @param {Record<string, any>} values
   */
  async setValues({ id, stamp }, values) {
    await this.#edit(this.#place(this.tool.map), [{ id, stamp, values }]);
    await this.tool.load();
  }

  /** Delete the chosen feature. */
  async remove() {
    const { chosen } = this.tool;
    if (!chosen) return this.tool.studio.say("choose a feature first", true);
    await this.#edit(this.#place(this.tool.map), [{ id: chosen.id, stamp: chosen.stamp, remove: true }]);
    return this.tool.load();
  }

  /**
   * Layer that is open, and the picture whose coordinates changes have.
   * @param {any} side
   */
  #place(side) {
    return { layer: this.tool.layerId, picture: side.name === "image" ? { image: this.tool.studio.image?.id } : { map_layer: this.tool.mapId } };
  }

  /**
   * @param {{layer: string, picture: any}} place
   * @param {any[]} changes
   * @param {string} [page] key of the sketch that is saved with them
   */
  #edit({ layer, picture }, changes, page) {
    const { tool, after } = this, shared = tool.sharedBox.checked;
    tool.serial += 1; // what is being read does not have this edit
    const name = (/** @type {number} */ id, /** @type {string} */ stamp) => `${layer} ${id} ${stamp}`;
    const now = (/** @type {any} */ one) => {
      let { stamp } = one;
      while (after.has(name(one.id, stamp))) stamp = after.get(name(one.id, stamp));
      return { ...one, stamp };
    };
    return tool.studio.attempt(async () => {
      const made = await edit("POST", `/api/features/layers/${layer}/edits`, () => ({ changes: changes.map(now), ...picture, shared, page }));
      for (const [id, before, stamp] of made.stamps) {
        after.set(name(id, before), stamp);
        after.delete(name(id, stamp));
      }
      tool.studio.say([made.title, ...made.notes].join("; "), made.notes.length > 0);
      return made;
    });
  }
}
