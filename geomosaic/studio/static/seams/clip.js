// Parts of a layer: what is drawn of it lies within an outline, given in pixels of the map's pane.

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

/**
 * Draw a layer within an outline only.
 * @param {any} layer OpenLayers'
 * @param {() => number[][] | null} outline pixels of the pane; null for all of it
 * @param {boolean} [framed] whether the outline is drawn
 */
export function clipped(layer, outline, framed = false) {
  /** @type {number[][] | null} */
  let corners = null;
  const trace = (/** @type {any} */ event) => {
    const { context } = event;
    context.beginPath();
    for (const [i, corner] of (corners ?? []).entries()) {
      const [x, y] = ol.render.getRenderPixel(event, corner);
      if (i) context.lineTo(x, y);
      else context.moveTo(x, y);
    }
    context.closePath();
    return context;
  };
  layer.on("prerender", (/** @type {any} */ event) => {
    corners = outline();
    if (!corners) return;
    event.context.save();
    trace(event).clip();
  });
  layer.on("postrender", (/** @type {any} */ event) => {
    if (!corners) return;
    event.context.restore();
    if (!framed) return;
    const context = trace(event);
    for (const [width, colour] of /** @type {[number, string][]} */ ([[4, "rgba(16,24,29,.8)"], [1.6, "#4de1ff"]])) Object.assign(context, { lineWidth: width, strokeStyle: colour }).stroke();
  });
}

/**
 * Corners of a circle.
 * @param {number[]} middle
 * @param {number} radius
 */
export const circle = (middle, radius) => Array.from({ length: 60 }, (_, i) => [middle[0] + radius * Math.cos((i * Math.PI) / 30), middle[1] + radius * Math.sin((i * Math.PI) / 30)]);
