// Base map: tiles of the web, from the address that the project file names, drawn in the CRS of the map.

import { get } from "./api.js";
import { element } from "./dom.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const TILES = "EPSG:3857";

/**
 * Polynomials as a transformation of places.
 * @param {number[]} centre of the source
 * @param {number[]} size half of it
 * @param {number[][]} coefficients of both coordinates
 * @param {number[]} toCentre
 * @param {number[]} toSize
 * @param {number} order
 */
function transformation(centre, size, coefficients, toCentre, toSize, order) {
  return (/** @type {number[]} */ at) => {
    const [u, v] = [(at[0] - centre[0]) / size[0], (at[1] - centre[1]) / size[1]];
    const sums = [0, 0];
    let term = 0;
    for (let i = 0, power = 1; i <= order; i += 1, power *= u) {
      for (let j = 0, product = power; j <= order - i; j += 1, product *= v, term += 1) {
        sums[0] += coefficients[0][term] * product;
        sums[1] += coefficients[1][term] * product;
      }
    }
    return [toCentre[0] + toSize[0] * sums[0], toCentre[1] + toSize[1] * sums[1]];
  };
}

/**
 * Layer of the base map; null where the project names none.
 * @param {any} main raster whose CRS the map has
 * @param {any} projection of the map
 * @param {(text: string, bad?: boolean) => void} say
 */
export async function baseMapLayer(main, projection, say) {
  const facts = await get(`/api/base_map?layer=${main.id}`);
  if (!facts) return null;
  const { map_centre: mapCentre, map_size: mapSize, tile_centre: tileCentre, tile_size: tileSize, order } = facts;
  ol.proj.addProjection(projection);
  ol.proj.addCoordinateTransforms(projection, TILES, transformation(mapCentre, mapSize, facts.to_tiles, tileCentre, tileSize, order),
    transformation(tileCentre, tileSize, facts.to_map, mapCentre, mapSize, order));
  const source = new ol.source.XYZ({ url: facts.address, projection: TILES, maxZoom: facts.largest_zoom, wrapX: false, crossOrigin: null, transition: 0 });
  let told = false;
  source.on("tileloaderror", () => {
    if (!told) say(`the base map of ${facts.host} does not answer; the page was perhaps loaded before the project named it`, true);
    told = true;
  });
  const drawn = new ol.layer.Tile({ source, extent: facts.extent, visible: false });
  return { layer: { id: "base", name: "Base map", role: "base", crs_name: facts.notice || facts.host, error: null }, drawn, why: null };
}

/**
 * Notice of the base map's makers over the map, as long as it is shown.
 * @param {any} view pane
 * @param {any} entry of the base map, null without one
 */
export function showNotice(view, entry) {
  view.canvas.querySelector(".notice")?.remove();
  if (!entry) return;
  const notice = element("div", { class: "notice" }, entry.layer.crs_name);
  const update = () => { notice.hidden = !entry.drawn.getVisible(); };
  entry.drawn.on("change:visible", update);
  update();
  view.canvas.append(notice);
}
