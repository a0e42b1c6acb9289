/** What the page shows at present. */

import { type Page, type Run } from "./data";
import { type Filters, noFilters, showsEvent } from "./filters";

export interface State {
  page: Page;
  filters: Filters;
  /** The times at the left and right edge. */
  from: number;
  to: number;
  cursor: number;
  /** The run that the keyboard acts on, and its event that is shown. */
  active: number;
  selected: number | null;
  isTable: boolean;
}

export const NARROWEST = 10_000;

export function begin(page: Page): State {
  const end = endOf(page);
  const first = page.firstDifference;
  const cursor = first === null ? firstTask(page.runs[0]) : timeOf(page.runs[0], first);
  return { page, filters: noFilters(), from: 0, to: end, cursor, active: 0, selected: null, isTable: false };
}

export function endOf(page: Page): number {
  return Math.max(1, ...page.runs.map((run) => run.end)) * 1.01;
}

/** The time of an event that both runs may have; the end of the run that is over before it. */
export function timeOf(run: Run, seq: number): number {
  return seq < run.events.length ? run.events[seq].time : run.end;
}

/** Something is going on there, unlike at the beginning. */
function firstTask(run: Run): number {
  return run.spans.find((span) => span.track === "work" && span.kind === "running")?.start ?? 0;
}

export function move(state: State, from: number, to: number): void {
  const end = endOf(state.page);
  const width = Math.min(end, Math.max(NARROWEST, to - from));
  state.from = Math.max(0, Math.min(from, end - width));
  state.to = state.from + width;
}

/** Zoom by a factor around a time that stays where it is. */
export function zoom(state: State, factor: number, around: number): void {
  const end = endOf(state.page);
  const width = Math.min(end, Math.max(NARROWEST, (state.to - state.from) / factor));
  const share = (around - state.from) / (state.to - state.from);
  move(state, around - share * width, around + (1 - share) * width);
}

/** Put the cursor at a time and bring it into view. */
export function point(state: State, time: number): void {
  state.cursor = Math.max(0, Math.min(time, endOf(state.page)));
  const width = state.to - state.from;
  if (state.cursor < state.from || state.cursor > state.to) {
    move(state, state.cursor - width / 2, state.cursor + width / 2);
  }
}

export function select(state: State, run: number, seq: number): void {
  state.active = run;
  state.selected = seq;
  point(state, state.page.runs[run].events[seq].time);
}

/** The next shown event after the selected one, or after the cursor; `step` 1 or -1. */
export function neighbour(state: State, step: 1 | -1): number | null {
  const run = state.page.runs[state.active];
  const isAhead = (seq: number): boolean => {
    if (state.selected !== null) {
      return step * (seq - state.selected) > 0;
    }
    return step > 0 ? run.events[seq].time > state.cursor : run.events[seq].time < state.cursor;
  };
  const order = step > 0 ? run.events : [...run.events].reverse();
  return order.find((event) => isAhead(event.seq) && showsEvent(state.filters, run, event))?.seq ?? null;
}
