// Calls of the studio's server, and the events it sends.

/** Answer of the server that says what is wrong, where, and how to go on. */
export class ServerError extends Error {
  /**
   * @param {number} status
   * @param {{what?: string, where?: string | null, hint?: string | null}} said
   */
  constructor(status, said) {
    const place = said.where ? `${said.where}: ` : "";
    super(`${place}${said.what ?? `the studio answered ${status}`}${said.hint ? `; ${said.hint}` : ""}`);
    this.status = status;
    this.said = said;
  }
}

const OWN = 3000; // milliseconds after an answer within which files that change are taken for this page's own doing
let changing = 0; // changes that are not answered yet
let changedAt = -Infinity; // when the last one was answered
/** @type {Promise<any>} */
let edited = Promise.resolve(); // all edits that were asked for

/** Until all edits are made that this page has asked for: what is made of the files waits for that. */
export const editsMade = () => edited;

/** Whether this page has asked for a change a moment ago. */
export const hasJustChanged = () => changing > 0 || performance.now() - changedAt < OWN;

/**
 * @param {string} path
 * @param {RequestInit} [how]
 * @returns {Promise<any>}
 */
async function call(path, how) {
  let answer;
  try {
    answer = await fetch(path, how);
  } catch {
    throw new ServerError(0, { what: "the studio does not answer", hint: "start it again: geomosaic studio" });
  }
  let values = {};
  try {
    values = await answer.json();
  } catch {
    // An answer without JSON is told by its status.
  }
  if (!answer.ok) throw new ServerError(answer.status, values);
  return values;
}

/**
 * JSON of a path.
 * @param {string} path
 * @returns {Promise<any>}
 */
export function get(path) {
  return call(path);
}

/**
 * Answer to a change.
 * @param {string} method
 * @param {string} path
 * @param {unknown} [values] sent as JSON
 * @returns {Promise<any>}
 */
export async function send(method, path, values = {}) {
  changing += 1;
  try {
    return await call(path, { method, headers: { "content-type": "application/json" }, body: JSON.stringify(values) });
  } finally {
    changing -= 1;
    changedAt = performance.now();
  }
}

/**
 * Answer to an edit, undo among them. Edits are made in the order in which they were asked for, each once those before it are answered.
 * @param {string} method
 * @param {string} path
 * @param {(() => unknown) | {}} [values] sent as JSON; a function gives them as late as they are sent
 * @returns {Promise<any>}
 */
export function edit(method, path, values = {}) {
  const answer = edited.then(() => send(method, path, typeof values === "function" ? values() : values));
  edited = answer.catch(() => {}); // who asked is told
  return answer;
}

/** Trade the token of the address, which works once, for this browser's cookie. */
export async function openSession() {
  const token = location.hash.slice(1);
  if (!token) return;
  history.replaceState(null, "", "/"); // neither the history nor a bookmark keeps it
  try {
    await send("POST", "/api/session", { token });
  } catch (error) {
    // A used token is no harm where the cookie is there: the next call tells.
    if (!(error instanceof ServerError) || error.status !== 401) throw error;
  }
}

/**
 * Events of the server, for as long as the page is open.
 * @param {(event: any) => void} told
 * @param {(connected: boolean) => void} connection
 */
export function listen(told, connection) {
  const source = new EventSource("/api/events");
  source.onopen = () => connection(true);
  source.onmessage = (message) => told(JSON.parse(message.data));
  source.onerror = () => {
    connection(false);
    // A browser gives up where the answer is no stream: a studio that was started again has not been opened yet.
    if (source.readyState === EventSource.CLOSED) setTimeout(() => listen(told, connection), 1500);
  };
}
