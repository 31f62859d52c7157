// Seams over the map: their lines, the place where one is taken, and the line that it would have.

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const stroke = (/** @type {string} */ color, /** @type {number} */ width, /** @type {number[]} */ lineDash = []) => new ol.style.Stroke({ color, width, lineDash });
const SEAM = [new ol.style.Style({ stroke: stroke("rgba(16,24,29,.8)", 5) }), new ol.style.Style({ stroke: stroke("#ff6b81", 2.4) })];
const SKETCH = [new ol.style.Style({ stroke: stroke("rgba(16,24,29,.8)", 4.5) }), new ol.style.Style({ stroke: stroke("#4de1ff", 2.4, [8, 6]), fill: new ol.style.Fill({ color: "rgba(77,225,255,.10)" }) })];
const PIECE = new ol.style.Style({ stroke: stroke("#4de1ff", 1.6), fill: new ol.style.Fill({ color: "rgba(77,225,255,.16)" }) });
const TAKEN = new ol.style.Style({ image: new ol.style.Circle({ radius: 6, fill: new ol.style.Fill({ color: "#4de1ff" }), stroke: stroke("#10181d", 2) }) });
// Pixels within which a seam is taken, and the least length of it to either side that moves.
const NEAR = 12;
const REACH = 36;

/** Drawings of seams, and how near a place is to one. */
export class SeamLines {
  /** @param {any} map OpenLayers' */
  constructor(map) {
    this.map = map;
    this.source = new ol.source.Vector();
    this.sketches = new ol.source.Vector();
    this.layers = [[this.source, SEAM, 30], [this.sketches, SKETCH, 31]].map(([source, style, zIndex]) => new ol.layer.Vector({ source, style, zIndex, map, visible: false }));
  }

  /** @param {boolean} on */
  show(on) {
    for (const layer of this.layers) layer.setVisible(on);
  }

  /** @param {any[]} seams as the server told them */
  set(seams) {
    this.source.clear();
    this.source.addFeatures(seams.map(({ first, second, line }) => new ol.Feature({ geometry: new ol.geom.LineString(line), first, second })));
  }

  /**
   * Nearest place on a seam.
   * @param {number[]} at
   * @param {number} [pixels] within which it is
   * @returns {{at: number[], line: number[][]} | null}
   */
  near(at, pixels = NEAR) {
    const seam = this.source.getClosestFeatureToCoordinate(at);
    const place = seam?.getGeometry().getClosestPoint(at);
    if (!place || Math.hypot(place[0] - at[0], place[1] - at[1]) > pixels * this.map.getView().getResolution()) return null;
    return { at: place, line: seam.getGeometry().getCoordinates() };
  }

  /**
   * Length of a seam, in map units, that moves to either side.
   * @param {number[]} from
   * @param {number[]} to
   */
  reach(from, to) {
    return Math.max(REACH * this.map.getView().getResolution(), 0.8 * Math.hypot(to[0] - from[0], to[1] - from[1]));
  }

  /**
   * Show how a seam would run; the server lays it.
   * @param {{at: number[], line: number[][]}} taken
   * @param {number[]} to
   */
  preview(taken, to) {
    const reach = this.reach(taken.at, to);
    const apart = (/** @type {number[]} */ a, /** @type {number[]} */ b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
    // The segment that the place lies on: the way over it is the shortest.
    const detours = taken.line.slice(1).map((one, i) => apart(taken.line[i], taken.at) + apart(taken.at, one) - apart(taken.line[i], one));
    const segment = detours.indexOf(Math.min(...detours));
    const ends = [-1, 1].map((step) => {
      let at = taken.at;
      let left = reach;
      for (let i = segment + (step > 0 ? 1 : 0); i >= 0 && i < taken.line.length; i += step) {
        const length = apart(at, taken.line[i]);
        if (length >= left) return at.map((value, k) => value + ((taken.line[i][k] - value) * left) / length);
        at = taken.line[i];
        left -= length;
      }
      return at;
    });
    this.sketch([new ol.geom.LineString([ends[0], to, ends[1]])]);
    this.#add(new ol.geom.Point(to), TAKEN);
  }

  /** @param {any[]} geometries drawn in place of those before */
  sketch(geometries) {
    this.sketches.clear();
    for (const geometry of geometries) this.#add(geometry, null);
  }

  /** @param {any[]} pieces polygons that can be chosen */
  pieces(pieces) {
    this.sketch([]);
    for (const [i, piece] of pieces.entries()) this.#add(piece, PIECE, { piece: i });
  }

  /**
   * @param {any} geometry
   * @param {any} style null for that of sketches
   * @param {Record<string, any>} [facts]
   */
  #add(geometry, style, facts = {}) {
    const feature = new ol.Feature({ geometry, ...facts });
    if (style) feature.setStyle(style);
    this.sketches.addFeature(feature);
  }
}
