// Numbers of control as text.

import { shown } from "../dom.js";

/**
 * Number, or a dash where it is not known.
 * @param {number | null | undefined} value
 * @param {number} decimals
 */
export const told = (value, decimals) => (value === null || value === undefined ? "–" : shown(value, decimals).replace(/^-(0\.?0*)$/, "$1"));

/** @param {(number | null)[] | undefined} pair of numbers, or of nothing */
export const length = (pair) => (pair && pair[0] !== null && pair[1] !== null ? Math.hypot(pair[0], pair[1]) : null);
