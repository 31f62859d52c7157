// Points, residuals, the point that is placed and the advice, drawn over image and map.

import { shown } from "../dom.js";
import { residualFactor } from "../drawings.js";
import { length } from "./numbers.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const COLOURS = /** @type {Record<string, string>} */ ({ control: "#22c1b2", check: "#ffd166", off: "#9aa7b0", outside: "#9aa7b0", blamed: "#ff4d5e" });

/**
 * Draw the state of the points over both panes.
 * @param {any} control
 */
export function drawControl(control) {
  const { panes, state, studio } = control;
  panes.clear();
  if (!control.open || !state) return;
  if (control.advice.facts) drawAdvice(panes.image, control.advice.facts);
  const scale = residualFactor(state.points.map((/** @type {any} */ one) => length(one.residual) ?? 0), state.size);
  const onMap = studio.mapView.home;
  for (const point of state.points) {
    const colour = point.blamed ? COLOURS.blamed : COLOURS[point.state];
    const mark = pointMark(colour, point.id, point.id === control.selected, point.state === "check");
    const at = [point.col, -point.row];
    panes.image.add(new ol.geom.Point(at), mark, { point: point.id });
    if (onMap && point.on_map?.[0] !== null && point.on_map) panes.map.add(new ol.geom.Point(point.on_map), mark, { point: point.id });
    if (!scale || !point.residual || point.residual[0] === null) continue;
    const stroke = new ol.style.Style({ stroke: new ol.style.Stroke({ color: colour, width: 2.5 }) });
    // From where the solution puts the point to where it was measured, lengthened.
    const start = [at[0] - point.residual[0], at[1] + point.residual[1]];
    panes.image.add(new ol.geom.LineString([start, [start[0] + scale * point.residual[0], start[1] - scale * point.residual[1]]]), stroke);
    if (onMap && point.measured_on_map && point.measured_on_map[0] !== null) {
      const [x, y] = point.on_map;
      panes.map.add(new ol.geom.LineString([[x, y], [x + scale * (point.measured_on_map[0] - x), y + scale * (point.measured_on_map[1] - y)]]), stroke);
    }
  }
  drawDraft(panes, control.placement);
  studio.imageView.note.textContent = scale ? `residuals × ${shown(scale, 0)}` : "";
  studio.mapView.note.textContent = scale && onMap ? `residuals × ${shown(scale, 0)}` : "";
}

/**
 * @param {string} colour
 * @param {string} name
 * @param {boolean} chosen
 * @param {boolean} check drawn as a triangle
 */
function pointMark(colour, name, chosen, check) {
  const radius = chosen ? 9 : 6;
  const looks = { radius, stroke: new ol.style.Stroke({ color: colour, width: chosen ? 3.5 : 2.2 }), fill: new ol.style.Fill({ color: "rgba(0,0,0,.15)" }) };
  return [
    new ol.style.Style({ image: check ? new ol.style.RegularShape({ ...looks, points: 3 }) : new ol.style.Circle(looks) }),
    new ol.style.Style({
      image: new ol.style.Circle({ radius: 1.5, fill: new ol.style.Fill({ color: colour }) }),
      text: new ol.style.Text({ text: name, offsetX: 11, offsetY: -11, textAlign: "left", font: "600 13px system-ui, sans-serif",
        fill: new ol.style.Fill({ color: "#fff" }), stroke: new ol.style.Stroke({ color: "#10181d", width: 3.5 }) }),
    }),
  ];
}

/**
 * @param {any} panes
 * @param {any} placement
 */
function drawDraft(panes, { draft, expected }) {
  const own = new ol.style.Style({ image: new ol.style.RegularShape({ points: 4, radius: 13, radius2: 0, angle: 0, stroke: new ol.style.Stroke({ color: "#fff", width: 2.5 }) }), zIndex: 3 });
  const ring = new ol.style.Style({ image: new ol.style.Circle({ radius: 14, stroke: new ol.style.Stroke({ color: "#fff", width: 2, lineDash: [5, 5] }) }), zIndex: 2 });
  if (draft.image) panes.image.add(new ol.geom.Point([draft.image[0], -draft.image[1]]), own);
  if (draft.map) panes.map.add(new ol.geom.Point(draft.map), own);
  if (expected.image && !draft.image) panes.image.add(new ol.geom.Point([expected.image[0], -expected.image[1]]), ring);
  if (expected.map && !draft.map) panes.map.add(new ol.geom.Point(expected.map), ring);
}

/**
 * @param {any} drawings
 * @param {any} advice
 */
function drawAdvice(drawings, advice) {
  const rows = advice.rms_with.length, cols = advice.rms_with[0].length;
  const [west, north, east, south] = advice.extent;
  const width = (east - west) / cols, height = (south - north) / rows;
  const known = advice.rms_with.flat().filter((/** @type {any} */ value) => value !== null);
  const least = Math.min(...known), most = Math.max(...known);
  for (let i = 0; i < rows; i += 1) {
    for (let j = 0; j < cols; j += 1) {
      const value = advice.rms_with[i][j];
      if (value === null) continue;
      const share = most > least ? (most - value) / (most - least) : 0;
      const [left, right, top, bottom] = [west + j * width, west + (j + 1) * width, -north - i * height, -north - (i + 1) * height];
      const cell = new ol.geom.Polygon([[[left, top], [right, top], [right, bottom], [left, bottom], [left, top]]]);
      drawings.add(cell, new ol.style.Style({ fill: new ol.style.Fill({ color: `rgba(${Math.round(40 + 215 * share)}, ${Math.round(60 + 120 * share)}, 60, ${(0.08 + 0.47 * share).toFixed(2)})` }), zIndex: -2 }));
    }
  }
  for (const [i, one] of advice.order.slice(0, 8).entries()) {
    drawings.add(new ol.geom.Point([one.col, -one.row]), new ol.style.Style({ zIndex: -1,
      image: new ol.style.Circle({ radius: 11, fill: new ol.style.Fill({ color: "#ffb703" }), stroke: new ol.style.Stroke({ color: "#10181d", width: 1.5 }) }),
      text: new ol.style.Text({ text: String(i + 1), font: "700 12px system-ui, sans-serif", fill: new ol.style.Fill({ color: "#10181d" }) }) }));
  }
}
