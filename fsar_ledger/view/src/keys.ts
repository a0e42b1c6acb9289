/** What the keys do. */

import { eventAt } from "./data";
import { byId } from "./dom";
import { endOf, move, neighbour, point, type State, timeOf, zoom } from "./state";

interface Actions {
  state: State;
  redraw: () => void;
  choose: (run: number, seq: number) => void;
  toggleTable: () => void;
  toggleFilters: () => void;
  nextTheme: () => void;
  openHelp: () => void;
}

const SECOND = 1e6;

export function onKey(event: KeyboardEvent, actions: Actions): void {
  const target = event.target as HTMLElement;
  const isWriting = ["SELECT", "INPUT", "TEXTAREA"].includes(target.tagName);
  const isPressing = ["Enter", " "].includes(event.key);
  const isBusy = event.ctrlKey || event.metaKey || event.altKey || isWriting || isPressing;
  if (isBusy || byId<HTMLDialogElement>("help").open) {
    return;
  }
  const key = event.shiftKey && event.key.startsWith("Arrow") ? `Shift+${event.key}` : event.key;
  const act = KEYS[key];
  if (act !== undefined) {
    event.preventDefault();
    act(actions);
    actions.redraw();
  }
}

const KEYS: Record<string, (actions: Actions) => void> = {
  ArrowLeft: (actions) => step(actions, -1),
  ArrowRight: (actions) => step(actions, 1),
  "Shift+ArrowLeft": ({ state }) => shift(state, -SECOND),
  "Shift+ArrowRight": ({ state }) => shift(state, SECOND),
  ArrowUp: toCause,
  ArrowDown: toEffect,
  Home: ({ state, choose }) => choose(state.active, 0),
  End: ({ state, choose }) => choose(state.active, state.page.runs[state.active].events.length - 1),
  "+": ({ state }) => zoom(state, 1.5, state.cursor),
  "=": ({ state }) => zoom(state, 1.5, state.cursor),
  "-": ({ state }) => zoom(state, 1 / 1.5, state.cursor),
  "0": ({ state }) => move(state, 0, endOf(state.page)),
  "[": ({ state }) => pan(state, -0.5),
  "]": ({ state }) => pan(state, 0.5),
  d: toDifference,
  r: otherRun,
  t: ({ toggleTable }) => toggleTable(),
  f: ({ toggleFilters }) => toggleFilters(),
  l: ({ nextTheme }) => nextTheme(),
  "?": ({ openHelp }) => openHelp(),
  Escape: escape,
};

function step({ state, choose }: Actions, direction: 1 | -1): void {
  const found = neighbour(state, direction);
  if (found !== null) {
    choose(state.active, found);
  }
}

function shift(state: State, by: number): void {
  state.selected = null;
  point(state, state.cursor + by);
}

function pan(state: State, share: number): void {
  const by = share * (state.to - state.from);
  move(state, state.from + by, state.to + by);
}

function toCause({ state, choose }: Actions): void {
  const cause = state.selected === null ? null : state.page.runs[state.active].events[state.selected].cause;
  if (cause !== null) {
    choose(state.active, cause);
  }
}

function toEffect({ state, choose }: Actions): void {
  const effects = state.selected === null ? [] : (state.page.runs[state.active].effects.get(state.selected) ?? []);
  if (effects.length > 0) {
    choose(state.active, effects[0]);
  }
}

function toDifference({ state, choose }: Actions): void {
  const first = state.page.firstDifference;
  const run = state.page.runs[state.active];
  if (first !== null && first < run.events.length) {
    choose(run.index, first);
  } else if (first !== null) {
    point(state, timeOf(run, first));
  }
}

function otherRun({ state, choose }: Actions): void {
  const other = (state.active + 1) % state.page.runs.length;
  if (other !== state.active) {
    choose(other, eventAt(state.page.runs[other], state.cursor));
  }
}

function escape({ state, toggleFilters }: Actions): void {
  if (byId("filters").hidden) {
    state.selected = null;
  } else {
    toggleFilters();
    byId("filter").focus();
  }
}
