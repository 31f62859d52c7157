// Footprints, flight lines, tie points with their residuals and the rays of one of them, drawn over image and map.

import { residualFactor } from "../drawings.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const LINES = ["#ffb703", "#4cc9f0", "#f72585", "#90be6d", "#b388ff", "#ff7b54", "#2ec4b6", "#e9c46a"];
const NONE = "#9aa7b0";
const BAD = "#ff4d5e";
// Tie points by their rays: two rays leave an error along one of them unseen.
const RAYS = ["#9aa7b0", "#9aa7b0", "#ffd166", "#22c1b2", "#22c1b2"];

/** @param {number} line of flight, -1 of none */
export const lineColour = (line) => (line < 0 ? NONE : LINES[line % LINES.length]);

/**
 * Footprints and flight lines.
 * @param {any} drawings of the map
 * @param {any[]} images of the block
 * @param {string | null} chosen name of the image
 */
export function drawFootprints(drawings, images, chosen) {
  for (const image of images) {
    if (!image.footprint) continue;
    const colour = lineColour(image.line);
    const own = image.name === chosen;
    const ring = [...image.footprint, image.footprint[0]];
    drawings.add(new ol.geom.Polygon([ring]), new ol.style.Style({ zIndex: own ? 2 : 0,
      stroke: new ol.style.Stroke({ color: colour, width: own ? 4 : 1.6 }), fill: new ol.style.Fill({ color: own ? `${colour}30` : `${colour}10` }) }), { image: image.name });
  }
  const lines = new Map();
  for (const image of images) if (image.centre && image.line >= 0) lines.set(image.line, [...(lines.get(image.line) ?? []), image]);
  for (const [line, members] of lines) {
    const colour = lineColour(line);
    const path = members.map((/** @type {any} */ one) => one.centre);
    drawings.add(new ol.geom.LineString(path), new ol.style.Style({ stroke: new ol.style.Stroke({ color: colour, width: 2, lineDash: [7, 5] }), zIndex: 1 }));
    for (const image of members) {
      drawings.add(new ol.geom.Point(image.centre), new ol.style.Style({ zIndex: 3,
        image: new ol.style.Circle({ radius: image.name === chosen ? 6 : 4, fill: new ol.style.Fill({ color: colour }), stroke: new ol.style.Stroke({ color: "#10181d", width: 1.5 }) }),
        text: image.name === chosen ? label(image.name) : undefined }));
    }
  }
}

/**
 * Tie points of an image with their residuals.
 * @param {{image: any, map: any}} drawings
 * @param {any} ties as the server tells them
 * @param {number[]} size of the image
 * @param {string | null} chosen name of the point
 * @returns {number} how many times longer residuals are drawn
 */
export function drawTies(drawings, ties, size, chosen) {
  const good = ties.points.filter((/** @type {any} */ one) => !one.left_out && one.residual[0] !== null);
  const factor = residualFactor(good.map((/** @type {any} */ one) => Math.hypot(one.residual[0], one.residual[1])), size);
  const marks = new Map();
  const mark = (/** @type {string} */ colour) => {
    if (!marks.has(colour)) {
      marks.set(colour, new ol.style.Style({ image: new ol.style.Circle({ radius: 3.5, fill: new ol.style.Fill({ color: colour }), stroke: new ol.style.Stroke({ color: "#10181d", width: 1 }) }) }));
    }
    return marks.get(colour);
  };
  for (const point of ties.points) {
    const colour = point.left_out ? BAD : RAYS[Math.min(point.rays, 4)];
    const at = [point.col, -point.row];
    const style = point.id === chosen ? chosenMark(colour, point.id) : mark(colour);
    drawings.image.add(new ol.geom.Point(at), style, { point: point.id });
    if (point.on_map[0] !== null) drawings.map.add(new ol.geom.Point(point.on_map), style, { point: point.id });
    if (!factor || point.residual[0] === null) continue;
    // From where the adjustment puts the point to where it was measured, lengthened; a blunder in its true length.
    const times = point.left_out ? 1 : factor;
    const start = [at[0] - point.residual[0], at[1] + point.residual[1]];
    drawings.image.add(new ol.geom.LineString([start, [start[0] + times * point.residual[0], start[1] - times * point.residual[1]]]),
      new ol.style.Style({ stroke: new ol.style.Stroke({ color: colour, width: 2 }) }));
  }
  return factor;
}

/**
 * Rays of a point, from the middle of each image that shows it.
 * @param {any} drawings of the map
 * @param {any} rays as the server tells them
 * @param {any[]} images of the block
 */
export function drawRays(drawings, rays, images) {
  if (rays.on_map[0] === null) return;
  for (const ray of rays.rays) {
    const centre = images.find((one) => one.name === ray.name)?.centre;
    if (!centre) continue;
    drawings.add(new ol.geom.LineString([centre, rays.on_map]), new ol.style.Style({ zIndex: 4,
      stroke: new ol.style.Stroke({ color: ray.left_out ? BAD : "#ffffff", width: 1.8, lineDash: ray.left_out ? [4, 5] : undefined }) }));
  }
}

/** @param {string} text */
function label(text) {
  return new ol.style.Text({ text, offsetY: -14, font: "600 13px system-ui, sans-serif", fill: new ol.style.Fill({ color: "#fff" }), stroke: new ol.style.Stroke({ color: "#10181d", width: 3.5 }) });
}

/**
 * @param {string} colour
 * @param {string} name
 */
function chosenMark(colour, name) {
  return new ol.style.Style({ zIndex: 5, text: label(name),
    image: new ol.style.Circle({ radius: 9, stroke: new ol.style.Stroke({ color: colour, width: 3.5 }), fill: new ol.style.Fill({ color: "rgba(0,0,0,.15)" }) }) });
}
