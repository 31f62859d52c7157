// Runs of the project's steps: progress, log, stop, and what is stale.

import { editsMade, get, send } from "./api.js";
import { element } from "./dom.js";
import { showSteps } from "./panels.js";

const UNDER_WAY = ["running", "stopping"];
const LOOKS = /** @type {Record<string, string>} */ ({ done: "good", quality: "warn", stopped: "warn", failed: "bad" });

/** The tab of steps. */
export class Runs {
  stale = element("button", { id: "run-stale", class: "primary", onclick: () => this.start([], false) }, "Run what is stale");
  stopButton = element("button", { id: "run-stop", onclick: () => this.stop() }, "Stop");
  bar = element("progress", { id: "run-progress", "aria-labelledby": "run-stage" });
  stage = element("p", { id: "run-stage", "aria-live": "polite" });
  log = element("ol", { id: "run-log", class: "log", tabindex: "0", "aria-label": "Log of the run" });
  list = element("div");
  state = "";
  serial = 0; // of the state that is shown
  seenAt = -Infinity; // when a run was last seen at work
  ended = 0; // runs that were seen to end

  /** @param {any} studio */
  constructor(studio) {
    this.studio = studio;
    studio.tabs.panel("steps").append(element("div", { class: "tools" }, this.stale, this.stopButton), this.stage, this.bar, this.log, this.list);
    this.show(null);
  }

  /** Whether a run is at work or was a moment ago: files that change then are its own. */
  get atWork() {
    return UNDER_WAY.includes(this.state) || performance.now() - this.seenAt < 2000;
  }

  /** Read the run anew. */
  async load() {
    this.show(await get("/api/run"));
  }

  /** @param {any[]} steps of the project */
  showSteps(steps) {
    showSteps(this.list, steps, (step) => this.start([step.name], step.fresh));
    this.stale.hidden = !steps.some((step) => !step.fresh);
    this.#enable();
  }

  /**
   * @param {string[]} steps
   * @param {boolean} force
   */
  async start(steps, force) {
    await this.studio.attempt(async () => {
      await editsMade();
      this.show(await send("POST", "/api/run", { steps, force }));
    });
  }

  async stop() {
    await this.studio.attempt(async () => this.show(await send("POST", "/api/run/stop")));
  }

  /** @param {any} run as the server tells it; null where there was none */
  show(run) {
    if (run && run.serial < this.serial) return; // an event was faster than the answer
    this.serial = run?.serial ?? 0;
    const before = this.state;
    this.state = run?.state ?? "";
    const active = UNDER_WAY.includes(this.state);
    if (active || UNDER_WAY.includes(before)) this.seenAt = performance.now();
    this.stopButton.hidden = !active;
    this.stopButton.toggleAttribute("disabled", this.state === "stopping");
    this.bar.hidden = !active;
    if (run?.total) {
      this.bar.setAttribute("max", String(run.total));
      this.bar.setAttribute("value", String(run.done));
    } else this.bar.removeAttribute("value");
    const ended = run ? [run.where ? `${run.where}: ${run.what}` : run.what, run.hint].filter(Boolean).join("; ") : "";
    const words = !run ? "" : this.state === "stopping" ? "stopping …" : active ? run.stage : ended;
    if (this.stage.textContent !== words) this.stage.textContent = words;
    this.stage.className = LOOKS[this.state] ?? "";
    const lines = run?.log ?? [];
    this.log.hidden = !lines.length;
    if (this.log.childElementCount !== lines.length || this.log.lastChild?.textContent !== lines.at(-1)) {
      this.log.replaceChildren(...lines.map((/** @type {string} */ line) => element("li", {}, line)));
      this.log.scrollTop = this.log.scrollHeight;
    }
    this.#enable();
    if (UNDER_WAY.includes(before) && !active) {
      this.ended += 1;
      this.studio.attempt(() => this.studio.load());
      this.studio.say(`the run: ${words}`, this.state === "failed");
    }
  }

  #enable() {
    for (const button of [this.stale, ...this.list.querySelectorAll("button.run")]) button.toggleAttribute("disabled", UNDER_WAY.includes(this.state));
  }
}
