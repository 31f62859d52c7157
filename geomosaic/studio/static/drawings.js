// Drawings over a pane: features with their styles, and residuals in a length that can be seen.

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

// Drawn length of the longest residual, as a share of the image's shorter side.
const LONGEST = 0.12;

/** Layer of drawings over a pane, whatever raster it shows. */
export class Drawings {
  /** @param {any} map OpenLayers' */
  constructor(map) {
    this.source = new ol.source.Vector();
    this.layer = new ol.layer.Vector({ source: this.source, zIndex: 50, map });
  }

  clear() {
    this.source.clear();
  }

  /**
   * @param {any} geometry
   * @param {any} style
   * @param {Record<string, any>} [facts]
   */
  add(geometry, style, facts = {}) {
    const feature = new ol.Feature({ geometry, ...facts });
    feature.setStyle(style);
    this.source.addFeature(feature);
  }
}

/**
 * Round factor that draws the longest residual in a convenient length; 0 without residuals.
 * @param {number[]} lengths of the residuals, pixels
 * @param {number[]} size width and height of the image
 */
export function residualFactor(lengths, size) {
  const longest = lengths.reduce((most, one) => Math.max(most, one), 0);
  if (!(longest > 1e-6)) return 0;
  const wanted = (LONGEST * Math.min(...size)) / longest;
  const power = 10 ** Math.floor(Math.log10(wanted));
  return Math.max(1, [1, 2, 5].map((step) => step * power).filter((step) => step <= wanted).at(-1) ?? 1);
}
