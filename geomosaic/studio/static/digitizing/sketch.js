// What is being drawn: kept by the server vertex by vertex, taken back, dropped, and gone on with by a later page.

import { edit } from "../api.js";

const newKey = () => Math.random().toString(36).slice(2, 12);

/** Sketch of this page, of which a picture has the line. */
export class Sketch {
  key = newKey(); // of what is being drawn
  going = false; // whether something is being drawn
  /** @type {Promise<any>} */
  sending = Promise.resolve();

  /** @param {any} tool */
  constructor(tool) {
    this.tool = tool;
  }

  /**
   * Keep what is being drawn: the server has it on its disk before it answers.
   * @param {any} side
   * @param {string} kind
   * @param {number[][]} places
   */
  keep(side, kind, places) {
    const { tool } = this;
    this.going = true;
    const drawn = { layer: tool.layerId, side: side.name, picture: side.name === "image" ? tool.studio.image?.id : tool.mapId, kind, coordinates: places };
    if (places.length) this.#send(drawn);
  }

  /**
   * Draw it no longer: it is kept until it is saved, gone on with or dropped, and the next sketch is another one.
   * @returns {string} its key
   */
  leave() {
    const { key } = this;
    this.going = false;
    this.key = newKey();
    return key;
  }

  /** Forget what was being drawn. */
  drop() {
    this.going = false;
    this.#send(null);
    this.sending.then(() => this.tool.load());
  }

  /** Take the last vertex back; the first one ends the drawing. */
  takeBack() {
    for (const side of [this.tool.image, this.tool.map]) {
      if (side.sketched.length > 1) side.draw.removeLastPoint();
      else side.draw?.abortDrawing();
    }
  }

  /** @param {any} drawn in the order in which it was drawn */
  #send(drawn) {
    this.sending = this.tool.studio.attempt(() => edit("PUT", "/api/features/sketch", { page: this.key, drawn }));
  }

  /**
   * Go on with what was being drawn before.
   * @param {string} key of the sketch
   * @param {any} drawn
   */
  async resume(key, drawn) {
    const { tool } = this, { studio } = tool, side = tool[/** @type {"image" | "map"} */ (drawn.side)];
    tool.setMode("choose");
    tool.wanted = drawn.layer;
    await tool.load();
    if (drawn.side === "image" && studio.image?.id !== drawn.picture) {
      const image = [...studio.project.images, ...studio.project.layers].find((/** @type {any} */ one) => one.id === drawn.picture);
      if (!image) return studio.say("the image that was drawn in is gone", true);
      await studio.openImage(image);
      await tool.load();
    }
    const on = studio.project.layers.find((/** @type {any} */ one) => one.id === drawn.picture);
    const there = drawn.side === "image" ? studio.image?.id === drawn.picture : on?.map_crs === studio.mapMain?.map_crs;
    tool.kindChoice.value = drawn.kind;
    if (there && tool.layerId === drawn.layer) tool.setMode("draw");
    if (tool.mode !== "draw" || tool.kind !== drawn.kind || !side.draw) return studio.say("it cannot be gone on with: its layer, or the picture that it was drawn in, is not open", true);
    side.extend(drawn.coordinates);
    await edit("PUT", "/api/features/sketch", { page: key, drawn: null });
    tool.overview.sketches = {};
    tool.waiting.render();
    studio.say("go on with the next vertex");
    return undefined;
  }
}
