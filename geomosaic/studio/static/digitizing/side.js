// One picture to draw in: the features it shows, and OpenLayers' interactions that draw, move and snap. A picture's
// places are col and row of the image, or coordinates of the map; OpenLayers' y of an image is minus the row.

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const format = new ol.format.GeoJSON();
const COLOURS = { line: "#ff7b00", chosen: "#00e5ff", halo: "rgba(10, 20, 26, .75)" };
const SNAP = 10; // screen pixels
const LEAST = 14; // screen pixels of a feature whose vertices are shown

/** @param {any} stroke OpenLayers' stroke, drawn over a dark halo */
const haloed = (stroke) => [
  new ol.style.Style({ stroke: new ol.style.Stroke({ color: COLOURS.halo, width: stroke.width + 2.5, lineDash: stroke.lineDash }) }),
  new ol.style.Style({ stroke: new ol.style.Stroke(stroke), fill: new ol.style.Fill({ color: `${stroke.color}26` }) }),
];

/** @param {string} color */
const dot = (color, /** @type {number} */ radius) => new ol.style.Circle({ radius, fill: new ol.style.Fill({ color }), stroke: new ol.style.Stroke({ color: "#10181d", width: 1.5 }) });

// Made once: OpenLayers draws features of one style together, and there may be 20,000 of them.
const [PLAIN, CHOSEN] = [[COLOURS.line, 2, 5.5, 1], [COLOURS.chosen, 3, 7, 2]].map(([color, width, radius, zIndex]) => ({
  lines: haloed({ color, width }),
  hidden: haloed({ color, width, lineDash: [5, 6] }),
  point: [new ol.style.Style({ zIndex, image: dot(String(color), Number(radius)) })],
  thin: [new ol.style.Style({ stroke: new ol.style.Stroke({ color: `${color}66`, width: 1 }), fill: new ol.style.Fill({ color: "rgba(0,0,0,0)" }) })],
}));
const HANDLES = new ol.style.Style({
  zIndex: 3, geometry: (/** @type {any} */ one) => new ol.geom.MultiPoint(vertices(one.getGeometry())),
  image: new ol.style.RegularShape({ points: 4, radius: 5, angle: Math.PI / 4, fill: new ol.style.Fill({ color: "#fff" }), stroke: new ol.style.Stroke({ color: "#10181d", width: 1.2 }) }),
});

/** Picture with the features of the layer that is digitized. */
export class Side {
  /**
   * @param {any} tool
   * @param {"image" | "map"} name
   * @param {any} view RasterView
   */
  constructor(tool, name, view) {
    this.tool = tool;
    this.name = name;
    this.view = view;
    this.source = new ol.source.Vector(); // features by their vertices
    this.pieces = new ol.source.Vector(); // what a photo shows of them, along the relief
    this.marks = new ol.source.Vector(); // place under the pointer of the other picture, its ellipse
    const map = view.map;
    this.piecesLayer = new ol.layer.Vector({ source: this.pieces, zIndex: 55, map, style: (/** @type {any} */ one) => this.#pieceStyle(one) });
    this.layer = new ol.layer.Vector({ source: this.source, zIndex: 56, map, style: (/** @type {any} */ one, /** @type {number} */ resolution) => this.#style(one, resolution) });
    this.marksLayer = new ol.layer.Vector({ source: this.marks, zIndex: 58, map });
    /** @type {any[]} */
    this.interactions = [];
    /** @type {any} */
    this.draw = null;
    /** @type {any} */
    /** @type {any} */
    this.modify = null;
    this.sketch = null; // OpenLayers' feature while it is drawn
    map.on("click", (/** @type {any} */ event) => this.#click(event));
  }

  /** @param {number[]} at OpenLayers' coordinate */
  place(at) {
    return this.name === "image" ? [at[0], -at[1]] : [at[0], at[1]];
  }

  /**
   * GeoJSON of a picture in OpenLayers' coordinates, or back: y is turned, to the bit.
   * @param {any} geometry
   */
  #turned(geometry) {
    if (this.name === "image") geometry.applyTransform((/** @type {number[]} */ values, /** @type {number[]} */ out, /** @type {number} */ size) => {
      for (let i = 1; i < values.length; i += size) out[i] = -values[i];
      return out;
    });
    return geometry;
  }

  /** @param {any} written GeoJSON in the picture's coordinates */
  read(written) {
    return this.#turned(format.readGeometry(written));
  }

  /** @param {any} geometry OpenLayers' */
  write(geometry) {
    return format.writeGeometryObject(this.#turned(geometry.clone()));
  }

  clear() {
    this.source.clear();
    this.pieces.clear();
    this.marks.clear();
  }

  /**
   * Show features.
   * @param {any[]} features as the server tells them
   */
  show(features) {
    const made = [], pieces = [];
    for (const one of features) {
      if (one[this.name]) {
        const feature = new ol.Feature({ geometry: this.read(one[this.name]), stamp: one.stamp });
        feature.setId(one.id);
        made.push(feature);
      }
      if (this.name === "image") for (const piece of one.drawn) pieces.push(new ol.Feature({ geometry: this.read(piece.geometry), of: one.id, hidden: piece.hidden }));
    }
    for (const [source, shown] of [[this.source, made], [this.pieces, pieces]]) {
      source.clear(true);
      source.addFeatures(shown);
    }
  }

  /** Draw anew what depends on what is chosen. */
  restyle() {
    this.layer.changed();
    this.piecesLayer.changed();
  }

  /** Drop all interactions. */
  stop() {
    for (const one of this.interactions) this.view.map.removeInteraction(one);
    this.interactions = [];
    this.draw = null;
    this.modify = null;
    this.sketch = null;
    this.view.canvas.classList.remove("placing");
    this.#zoomByDoubleClick(true);
  }

  /** @param {string} kind Point, LineString or Polygon */
  startDrawing(kind) {
    this.stop();
    const { tool } = this;
    const draw = new ol.interaction.Draw({
      type: kind, stopClick: true, snapTolerance: SNAP, trace: tool.traceBox.checked, traceSource: this.source,
      style: [...haloed({ color: COLOURS.chosen, width: 2 }), new ol.style.Style({ image: dot(COLOURS.chosen, 5) })],
    });
    draw.on("drawstart", (/** @type {any} */ event) => {
      let kept = 0;
      this.sketch = event.feature;
      event.feature.on("change", () => {
        const vertices = this.sketched;
        if (vertices.length === kept) return; // the pointer has moved
        kept = vertices.length;
        tool.sketch.keep(this, kind, vertices);
      });
      tool.sketch.keep(this, kind, this.sketched);
    });
    draw.on("drawend", (/** @type {any} */ event) => {
      this.sketch = null;
      tool.edits.finish(this, kind, event.feature.getGeometry());
    });
    draw.on("drawabort", () => {
      this.sketch = null;
      if (tool.sketch.going) tool.sketch.drop();
    });
    this.draw = draw;
    this.#add(draw);
    this.view.canvas.classList.add("placing");
    this.#zoomByDoubleClick(false);
  }

  /** Vertices of what is being drawn, without the one that follows the pointer; places of the picture. */
  get sketched() {
    const geometry = this.sketch?.getGeometry();
    const coordinates = geometry?.getCoordinates() ?? [];
    const line = geometry?.getType() === "Polygon" ? coordinates[0].slice(0, -2) : geometry?.getType() === "LineString" ? coordinates.slice(0, -1) : [];
    return line.map((/** @type {number[]} */ at) => this.place(at));
  }

  /** @param {number[][]} places of the picture, to go on from */
  extend(places) {
    this.draw?.appendCoordinates(places.map((at) => (this.name === "image" ? [at[0], -at[1]] : at)));
  }

  startModifying() {
    this.stop();
    const { tool } = this;
    const chosen = new ol.Collection(this.source.getFeatures().filter((/** @type {any} */ one) => one.getId() === tool.selected));
    const modify = new ol.interaction.Modify({ ...(tool.sharedBox.checked ? { source: this.source } : { features: chosen }), pixelTolerance: SNAP,
      // At once: after OpenLayers' pause for a double click the layer may have been read anew.
      deleteCondition: (/** @type {any} */ event) => event.type === "click" && ol.events.condition.altKeyOnly(event) });
    modify.on("modifyend", () => tool.edits.reshape(this));
    this.modify = modify;
    this.#add(modify);
  }

  /** @param {any} interaction before snapping, which must be the last */
  #add(interaction) {
    const snap = new ol.interaction.Snap({ source: this.source, pixelTolerance: SNAP });
    for (const one of this.tool.snapBox.checked ? [interaction, snap] : [interaction]) {
      this.view.map.addInteraction(one);
      this.interactions.push(one);
    }
  }

  /** @param {boolean} on */
  #zoomByDoubleClick(on) {
    for (const one of this.view.map.getInteractions().getArray()) if (one instanceof ol.interaction.DoubleClickZoom) one.setActive(on);
  }

  /** @param {any} event */
  #click(event) {
    if (!this.tool.open || this.draw || event.originalEvent.altKey) return; // Alt takes a vertex out
    /** @type {number | null} */
    let found = null;
    this.view.map.forEachFeatureAtPixel(event.pixel, (/** @type {any} */ one) => { found ??= one.getId() ?? one.get("of") ?? null; },
      { hitTolerance: 6, layerFilter: (/** @type {any} */ one) => one === this.layer || one === this.piecesLayer });
    if (found !== null || this.tool.mode === "choose") this.tool.choose(found, false);
  }

  /**
   * @param {any} feature
   * @param {number} resolution of the picture
   */
  #style(feature, resolution) {
    const chosen = feature.getId() === this.tool.selected;
    const own = chosen ? CHOSEN : PLAIN;
    const geometry = feature.getGeometry();
    if (geometry.getType().endsWith("Point")) return own.point;
    const moving = this.tool.mode === "move";
    // A photo shows the feature along the relief; its straight lines from vertex to vertex only while they are moved.
    const lines = this.name === "map" || !this.tool.relief ? own.lines : moving ? own.thin : [];
    const [left, bottom, right, top] = geometry.getExtent();
    return chosen || (moving && Math.max(right - left, top - bottom) > LEAST * resolution) ? [...lines, HANDLES] : lines;
  }

  /** @param {any} piece */
  #pieceStyle(piece) {
    const own = piece.get("of") === this.tool.selected ? CHOSEN : PLAIN;
    if (piece.getGeometry().getType() === "Point") return [];
    return piece.get("hidden") ? own.hidden : own.lines;
  }
}

/**
 * Vertices of a geometry.
 * @param {any} geometry
 * @returns {number[][]}
 */
export function vertices(geometry) {
  const flat = geometry.getFlatCoordinates();
  const size = geometry.getStride();
  return Array.from({ length: flat.length / size }, (_, i) => [flat[i * size], flat[i * size + 1]]);
}
