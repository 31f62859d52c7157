// The page: opens the session, holds the state of the project, and joins views and panels.

import { edit, get, hasJustChanged, listen, openSession } from "./api.js";
import { baseMapLayer, showNotice } from "./base_map.js";
import { BlockTool } from "./block/block.js";
import { Control } from "./control/control.js";
import { Digitizing } from "./digitizing/digitizing.js";
import { KeyboardCursor } from "./cursor.js";
import { byId, element } from "./dom.js";
import { showImages, showLayers, showMessages, sideTabs } from "./panels.js";
import { RasterView } from "./raster_view.js";
import { Runs } from "./run.js";
import { Seams } from "./seams/seams.js";
import { SheetTool } from "./sheet/sheet.js";

/** @type {any} */
const ol = /** @type {any} */ (globalThis).ol;

const TABS = [
  { id: "images", title: "Images" }, { id: "block", title: "Block" }, { id: "control", title: "Control" }, { id: "features", title: "Draw" }, { id: "seams", title: "Seams" }, { id: "sheet", title: "Sheet" }, { id: "layers", title: "Layers" }, { id: "steps", title: "Steps" }, { id: "messages", title: "Messages" },
];
// Keys that the browser, or the picture that has the focus, takes by itself.
const OWN_KEYS = [["Tab", "from part to part"], ["Ctrl Z", "undo"], ["Ctrl Y", "redo"]];
const PICTURE_KEYS = [
  ["Arrows + -", "move and zoom the picture that has the focus"],
  ["Arrows", "while a tool waits for a place: move the cross, with Shift by one pixel of the screen"],
  ["Enter", "click at the cross; twice ends a line or an area. Where things are dragged: take hold, and drop"],
];

/**
 * Whether two images are shown by the same picture.
 * @param {any} one
 * @param {any} other
 */
const samePicture = (one, other) => Boolean(one && other) && ["id", "version", "error"].every((key) => one[key] === other[key]);

/** The studio of the page: what modules of single tasks work with. */
class Studio extends EventTarget {
  constructor() {
    super();
    /** @type {any} */
    this.project = null;
    /** @type {any} */
    this.image = null; // that is shown
    /** @type {any} */
    this.opening = null; // that was asked for last, which may be read still; the one that is shown where it could not be read
    this.imageId = ""; // of it; while the project file has an error none is shown
    this.tabs = sideTabs(TABS);
    const say = this.say.bind(this);
    this.imageView = new RasterView(byId("image-view"), say);
    this.mapView = new RasterView(byId("map-view"), say);
    this.mapKey = ""; // of the layers that the map shows
    /** @type {Promise<any>} */
    this.mapDrawn = Promise.resolve();
    /** @type {{layer: any, drawn: any, why: string | null}[]} */
    this.entries = [];
    this.loading = 0;
    /** @type {any[]} */
    this.steps = [];
    this.control = new Control(this);
    this.runs = new Runs(this);
    /** @type {any} */
    this.baseMap = null; // its entry among the layers
    this.chosenMap = ""; // id of the raster that was chosen as the map
    /** @type {any} */
    this.mapMain = null; // raster whose CRS the map has
    /** @type {Map<string, any>} tools by their tab: `show(on)`, `keys`, `placing` while clicks are theirs, `awaits(view)` and `holds` of the keyboard's cursor, `saving` while an edit waits for what is measured */
    this.tools = new Map(/** @type {[string, any][]} */ ([
      ["control", this.control],
      ["features", new Digitizing(this)],
      ["seams", new Seams(this)],
      ["block", new BlockTool(this)],
      ["sheet", new SheetTool(this)],
    ]));
    this.tab = "images"; // that is shown
    for (const view of [this.imageView, this.mapView]) view.cursor = new KeyboardCursor(view, () => this.tools.get(this.tab), say);
    this.tabs.onselect = (/** @type {string} */ id) => {
      this.tab = id;
      for (const [own, tool] of this.tools) tool.show(own === id);
    };
  }

  /**
   * Message at the foot of the page, read aloud by screen readers.
   * @param {string} text
   * @param {boolean} [bad]
   */
  say(text, bad = false) {
    const status = byId("status");
    status.textContent = text;
    status.title = text;
    status.classList.toggle("bad", bad);
  }

  /**
   * Run what may fail; what is wrong is told at the foot of the page.
   * @template T
   * @param {() => Promise<T>} act
   * @returns {Promise<T | undefined>}
   */
  async attempt(act) {
    try {
      return await act();
    } catch (error) {
      this.say(/** @type {Error} */ (error).message, true);
      return undefined;
    }
  }

  /** Read the project anew and show it. */
  async load() {
    const serial = ++this.loading;
    const before = this.project;
    const project = await get("/api/project");
    if (serial !== this.loading) return;
    this.project = project;
    const crs = project.layers.find((/** @type {any} */ one) => one.crs_name)?.crs_name ?? "no map CRS yet";
    document.title = `${project.name} · studio`;
    byId("project-name").textContent = project.name;
    byId("project-facts").textContent = `${project.file} · ${crs}`;
    const errors = project.messages.filter((/** @type {any} */ one) => one.kind === "error").length;
    showMessages(this.tabs.panel("messages"), project.messages);
    this.tabs.count("messages", project.messages.length ? String(project.messages.length) : "", errors > 0);
    this.tabs.count("images", String(project.images.length));
    if (errors) {
      this.tabs.select("messages");
      this.say("the project file has an error: see Messages", true);
    }
    this.showHistory(project.history);
    if (!before) this.chooseView(project.layers.some((/** @type {any} */ one) => one.on_map) ? (project.images.length ? "both" : "map") : "image");
    const image = [...project.images, ...project.layers].find((one) => one.id === this.imageId) ?? project.images[0] ?? null;
    if (!samePicture(image, this.opening)) await this.chooseImage(image);
    else {
      if (this.image === this.opening) this.image = this.opening = image; // others of its facts need no new picture
      this.#markImage(image);
    }
    await this.showMap();
    if (!before && !byId("status").classList.contains("bad")) this.say("ready");
    this.dispatchEvent(new Event("project"));
    const steps = await get("/api/steps");
    if (serial !== this.loading) return;
    this.steps = steps;
    this.runs.showSteps(steps);
    this.dispatchEvent(new Event("steps"));
    const stale = steps.filter((/** @type {any} */ step) => !step.fresh).length;
    this.tabs.count("steps", stale ? `${stale} stale` : "");
  }

  /** @param {any} image that is marked in the list */
  #markImage(image) {
    showImages(this.tabs.panel("images"), this.project.images, image?.id ?? null, (one) => this.openImage(one));
  }

  /**
   * Show an image in its own pixels. Until it is read the one before stays, with all that is done in it.
   * @param {any} image
   */
  async chooseImage(image) {
    this.opening = image;
    this.imageId ||= image?.id ?? "";
    this.#markImage(image);
    if (!image) this.imageView.empty(this.project.messages.some((/** @type {any} */ one) => one.kind === "error") ? "The project file has an error" : "The project has no images");
    else if (image.error) this.imageView.empty(`${image.name}: ${image.error}`);
    else {
      const shown = await this.attempt(() => this.imageView.showImage(image));
      if (shown === undefined && this.opening === image) this.#stay();
      if (!shown) return;
    }
    this.image = image;
    this.outlines?.changed();
    this.dispatchEvent(new Event("image"));
  }

  /** Stay with the image that is shown; where there is none, the next reading of the project tries again. */
  #stay() {
    this.opening = this.image;
    if (this.image) this.imageId = this.image.id;
    this.#markImage(this.image);
  }

  /**
   * Show an image, beside the map where that was alone.
   * @param {any} image
   */
  openImage(image) {
    this.imageId = image.id;
    if (byId("views").dataset.view === "map") this.chooseView("both");
    return samePicture(image, this.opening) ? undefined : this.chooseImage(image); // else the part that is shown stays
  }

  /** @param {number} step to the next or the previous image */
  nextImage(step) {
    const images = this.project?.images ?? [];
    if (!images.length) return;
    const at = images.findIndex((/** @type {any} */ one) => one.id === (this.imageId || this.image?.id));
    this.openImage(images[(at + step + images.length) % images.length]);
  }

  /** Show the layers of the project on the map, once what is being drawn there is done. */
  showMap() {
    this.mapDrawn = this.mapDrawn.then(() => this.attempt(() => this.#drawMap()));
    return this.mapDrawn;
  }

  /** Draw the layers that share a CRS, the mosaic's first. */
  async #drawMap() {
    const layers = this.project.layers;
    const key = JSON.stringify(layers);
    if (key === this.mapKey) return;
    this.mapKey = key;
    const same = (/** @type {any} */ one, /** @type {any} */ other) => one && other && JSON.stringify({ ...one, version: 0 }) === JSON.stringify({ ...other, version: 0 });
    const kept = this.mapView.home && this.mapView.map.getView().calculateExtent();
    const main = layers.find((/** @type {any} */ one) => one.id === this.chosenMap && one.on_map) ?? layers.find((/** @type {any} */ one) => one.role === "mosaic" && one.on_map) ?? layers.find((/** @type {any} */ one) => one.on_map);
    const stays = same(this.mapMain, main); // then the view stays, and layers whose pixels alone changed
    const before = new Map(this.entries.map((one) => [one.layer.id, one.drawn]));
    const old = new Map(this.entries.map((one) => [one.layer.id, one.layer]));
    /** @type {[any, any, string][]} */
    const renewed = [];
    /** @type {{layer: any, drawn: any, why: string | null}[]} */
    let entries = []; // those before stay until these are there
    const moved = this.mapMain && this.mapMain.map_crs !== main?.map_crs;
    this.mapMain = main ?? null;
    if (moved) this.dispatchEvent(new Event("crs")); // places of the map are no longer what they were
    if (main) {
      const projection = stays ? this.mapView.map.getView().getProjection() : this.mapView.startMap(main, main.crs_name ?? "Map");
      if (kept && before.has(main.id) && !stays && !moved) this.mapView.map.getView().fit(kept);
      for (const layer of layers) {
        const onMap = layer.on_map && layer.map_crs === main.map_crs;
        const shown = stays && same(old.get(layer.id), layer) ? before.get(layer.id) : null;
        if (shown && old.get(layer.id).version !== layer.version) renewed.push([shown, layer, old.get(layer.id).version]);
        const drawn = shown ?? (onMap ? await this.attempt(() => this.mapView.mapLayer(layer, projection)) : null);
        const why = layer.error ?? (onMap ? "it could not be read" : layer.on_map ? "in another CRS than the map" : "not north up, or without a georeference");
        if (onMap && !drawn) this.mapKey = ""; // the next reading of the project tries again
        entries.push({ layer, drawn: drawn ?? null, why });
      }
      const base = stays ? this.baseMap : await this.attempt(() => baseMapLayer(main, projection, (text, bad) => this.say(text, bad)));
      // What was switched while all this was read counts.
      for (const { layer, drawn } of entries) {
        drawn?.setVisible(before.get(layer.id)?.getVisible() ?? layer === main);
        drawn?.setOpacity(before.get(layer.id)?.getOpacity() ?? 1);
      }
      base?.drawn.setVisible(before.get("base")?.getVisible() ?? false);
      this.baseMap = base ?? null;
      if (this.baseMap) entries.push(this.baseMap);
      showNotice(this.mapView, this.baseMap);
      const order = ["dem", "reference", "ortho", "mosaic", "before", "sheet"];
      const sorted = [...entries].sort((a, b) => order.indexOf(a.layer.role) - order.indexOf(b.layer.role));
      const lines = stays ? this.entries.filter((one) => one.layer.role === "lines") : [];
      this.entries = [...lines, ...entries];
      this.mapView.map.setLayers([...sorted, ...lines].map((one) => one.drawn).filter(Boolean));
      for (const [drawn, layer, version] of renewed) {
        if (await this.attempt(() => this.#renew(drawn, layer, version))) continue;
        // Its pixels are as they were: the next reading tries again.
        this.mapKey = "";
        const own = this.entries.find((one) => one.drawn === drawn);
        if (own) own.layer = { ...layer, version };
      }
      if (!(await this.attempt(() => this.drawOutlines(projection, before)))) this.mapKey = "";
    } else {
      entries = layers.map((/** @type {any} */ layer) => ({ layer, drawn: null, why: layer.error ?? "not north up, or without a georeference" }));
      this.mapView.empty("No mosaic and no reference yet");
      this.entries = entries;
    }
    showLayers(this.tabs.panel("layers"), this.entries, (layer) => this.openImage(layer), (layer) => {
      this.chosenMap = layer.id;
      this.mapKey = "";
      this.showMap();
    });
    this.dispatchEvent(new Event("map"));
  }

  /**
   * Show a layer as its file is now; of the mosaic only what a run has changed is loaded.
   * @param {any} drawn
   * @param {any} layer
   * @param {string} version that was shown
   */
  async #renew(drawn, layer, version) {
    const found = layer.role === "mosaic" ? await get(`/api/seams/changes?since=${encodeURIComponent(version)}`) : { windows: null };
    await drawn.get("renew")(found.windows);
    return true;
  }

  /**
   * Footprints and seamlines over the map; a double click in a footprint shows its image.
   * @param {any} projection
   * @param {Map<string, any>} before
   */
  async drawOutlines(projection, before) {
    const found = await get("/api/outlines");
    const format = new ol.format.GeoJSON();
    for (const one of this.entries.filter(({ layer }) => layer.role === "lines")) this.mapView.map.removeLayer(one.drawn);
    this.entries = this.entries.filter(({ layer }) => layer.role !== "lines");
    for (const [id, name, colour] of [["footprints", "Footprints", "#ffd166"], ["seamlines", "Seamlines", "#ff5d73"]]) {
      if (!found[id]?.features.length) continue;
      const source = new ol.source.Vector({ features: format.readFeatures(found[id]) });
      const drawn = new ol.layer.Vector({
        source,
        style: (/** @type {any} */ feature) => {
          const chosen = id === "footprints" && feature.get("image") === this.image?.name;
          return new ol.style.Style({
            stroke: new ol.style.Stroke({ color: colour, width: chosen ? 3.5 : 1.3 }),
            fill: new ol.style.Fill({ color: chosen ? "rgba(255,209,102,.18)" : "rgba(0,0,0,0)" }), zIndex: chosen ? 1 : 0,
          });
        },
      });
      drawn.setVisible(before.get(id)?.getVisible() ?? id === "footprints");
      this.mapView.map.addLayer(drawn);
      this.entries.unshift({ layer: { id, name, role: "lines" }, drawn, why: null });
      if (id === "footprints") this.outlines = source;
    }
    return true;
  }

  /** @param {string} view 'map', 'image' or 'both' */
  chooseView(view) {
    byId("views").dataset.view = view;
    for (const box of document.querySelectorAll("input[name=view]")) {
      const input = /** @type {HTMLInputElement} */ (box);
      input.checked = input.value === view;
    }
    requestAnimationFrame(() => {
      for (const one of [this.imageView, this.mapView]) {
        const before = one.map.getSize();
        one.map.updateSize();
        if (!before || !before[0]) one.fit();
      }
    });
  }

  /** @param {{undo: string | null, redo: string | null}} titles */
  showHistory(titles) {
    for (const [id, word] of [["undo", "Undo"], ["redo", "Redo"]]) {
      const title = titles[/** @type {"undo" | "redo"} */ (id)];
      byId(id).disabled = !title;
      byId(id).title = title ? `${word}: ${title}` : `Nothing to ${word.toLowerCase()}`;
    }
  }

  /** @param {"undo" | "redo"} which */
  async takeBack(which) {
    if (this.tools.get(this.tab)?.takeBack?.(which)) return;
    await this.attempt(async () => {
      await this.tools.get(this.tab)?.saving;
      const done = await edit("POST", `/api/${which}`);
      this.say(`${which === "undo" ? "taken back" : "done again"}: ${done.title}`);
      this.dispatchEvent(new Event("takenback"));
      await this.load();
    });
  }
}

/** Light, dark, or what the system says. */
function prepareTheme() {
  const system = matchMedia("(prefers-color-scheme: dark)");
  const apply = () => {
    document.documentElement.dataset.theme = localStorage.getItem("theme") ?? (system.matches ? "dark" : "light");
  };
  system.addEventListener("change", apply);
  apply();
  return () => {
    localStorage.setItem("theme", document.documentElement.dataset.theme === "dark" ? "light" : "dark");
    apply();
  };
}

/** @param {string} key as keyboards show it */
const shownKey = (key) => key.charAt(0).toUpperCase() + key.slice(1);

/** @param {Studio} studio */
function prepareControls(studio) {
  const turnTheme = prepareTheme();
  const showKeys = () => {
    byId("keys").showModal();
    byId("keys").scrollTop = 0; // the focus is on the button at its end
  };
  const toggleSide = () => {
    const closed = document.body.dataset.side !== "closed";
    document.body.dataset.side = closed ? "closed" : "open";
    byId("toggle-side").setAttribute("aria-expanded", String(!closed));
    requestAnimationFrame(() => { studio.imageView.map.updateSize(); studio.mapView.map.updateSize(); });
  };
  const active = () => (byId("views").dataset.view === "image" || document.activeElement === studio.imageView.canvas ? studio.imageView : studio.mapView);
  const keys = /** @type {[string, string, () => void][]} */ ([
    ["1", "the map alone", () => studio.chooseView("map")],
    ["2", "the image alone", () => studio.chooseView("image")],
    ["3", "both", () => studio.chooseView("both")],
    ["]", "the next image", () => studio.nextImage(1)],
    ["[", "the previous image", () => studio.nextImage(-1)],
    ["0", "all of the picture that has the focus", () => active().fit()],
    ["s", "side panel", toggleSide],
    ["t", "light or dark", turnTheme],
    ["?", "these keys", showKeys],
  ]);
  const toolKeys = (/** @type {any} */ tool) => /** @type {[string, string, () => void][]} */ (tool?.keys ?? []);
  const groups = /** @type {[string, any[][]][]} */ ([
    ["Everywhere", [...keys, ...OWN_KEYS]], ["In a picture", PICTURE_KEYS],
    ...TABS.map(({ id, title }) => [`Tab ${title}`, toolKeys(studio.tools.get(id))]),
  ]);
  byId("key-list").append(...groups.filter(([, every]) => every.length).map(([title, every]) => element("section", { "aria-label": title }, element("h3", {}, title),
    element("dl", {}, ...every.flatMap(([key, words]) => [element("dt", {}, shownKey(key)), element("dd", {}, words)])))));
  document.addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (target.matches("input[type=search], input[type=text], input[type=number], textarea, select") || byId("keys").open) return;
    if (event.key === "Enter" && target.matches("button, a, summary, input")) return; // which it presses
    if (event.ctrlKey || event.metaKey) {
      const key = event.key.toLowerCase();
      const which = key === "y" || (key === "z" && event.shiftKey) ? "redo" : key === "z" ? "undo" : null;
      if (which) {
        event.preventDefault();
        studio.takeBack(which);
      }
      return;
    }
    const found = [...keys, ...toolKeys(studio.tools.get(studio.tab))].find(([key]) => key === event.key.toLowerCase());
    if (found && !event.altKey) {
      event.preventDefault();
      found[2]();
    }
  });
  byId("toggle-side").addEventListener("click", toggleSide);
  byId("theme").addEventListener("click", turnTheme);
  byId("help").addEventListener("click", showKeys);
  byId("undo").addEventListener("click", () => studio.takeBack("undo"));
  byId("redo").addEventListener("click", () => studio.takeBack("redo"));
  byId("view-choice").addEventListener("change", (/** @type {any} */ event) => studio.chooseView(event.target.value));
  studio.mapView.map.on("dblclick", (/** @type {any} */ event) => {
    if ([...studio.tools.values()].some((tool) => tool.placing)) return;
    const over = studio.mapView.map.getFeaturesAtPixel(event.pixel).map((/** @type {any} */ one) => one.get("image"));
    const image = studio.project?.images.find((/** @type {any} */ one) => over.includes(one.name));
    if (image) {
      studio.openImage(image);
      event.preventDefault();
    }
  });
}

async function start() {
  const studio = new Studio();
  prepareControls(studio);
  await studio.attempt(openSession);
  let lost = false;
  listen(
    (event) => {
      if (event.kind === "run") studio.runs.show(event.run);
      if (event.kind === "print") studio.tools.get("sheet").showPrint(event.print);
      if (event.kind === "waiting") studio.dispatchEvent(new Event("waiting"));
      if (event.kind !== "changed") return;
      const own = hasJustChanged() || studio.runs.atWork;
      studio.attempt(async () => {
        await studio.load();
        if (!own && studio.project?.messages.every((/** @type {any} */ one) => one.kind !== "error")) studio.say(`changed: ${event.files.slice(0, 4).join(", ")}`);
        studio.dispatchEvent(new CustomEvent("changed", { detail: event.files }));
      });
    },
    (connected) => {
      // What changed while nobody listened is read with the connection.
      if (connected) studio.attempt(() => Promise.all([studio.load(), studio.runs.load()]).then(() => { if (lost) studio.say("the studio answers again"); lost = false; }));
      else studio.attempt(() => get("/api/project")); // says why
      lost ||= !connected;
    },
  );
}

start();
