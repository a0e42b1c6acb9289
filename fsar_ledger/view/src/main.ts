/** Start the page: read its data, draw it, and answer to mouse, touch and keys. */

import { axis, draw, type Drawing, heading, scaleOf } from "./chart";
import { clock, load, said, seconds } from "./data";
import { byId, element } from "./dom";
import { isActive, showFilters } from "./filters";
import { onKey } from "./keys";
import { showLegend } from "./legend";
import { overview } from "./overview";
import { showEvent, showMoment } from "./panels";
import { listen } from "./pointer";
import { begin, endOf, move, select } from "./state";
import { showTables } from "./tables";

const state = begin(load(byId("data").textContent ?? ""));
const drawings: Drawing[] = [];
let isAsked = false;

/** Draw at the next frame, once however often it is asked for. */
export function redraw(): void {
  if (!isAsked) {
    isAsked = true;
    requestAnimationFrame(render);
  }
}

function render(): void {
  isAsked = false;
  const width = Math.max(280, byId("timeline").clientWidth);
  byId("overview").replaceChildren(overview(state, width));
  byId("axis").replaceChildren(axis(state, width));
  const runs = state.page.runs.map((run) => {
    drawings[run.index] = draw(state, run, width);
    const isOnly = state.page.runs.length === 1;
    const picture = element("div", { class: "run", "data-run": run.index });
    picture.append(...(isOnly ? [] : [heading(state, run)]), drawings[run.index].svg);
    return picture;
  });
  byId("runs").replaceChildren(...runs);
  byId("timeline").hidden = state.isTable;
  byId("legend").hidden = state.isTable;
  byId("tables").hidden = !state.isTable;
  byId("table").setAttribute("aria-pressed", `${state.isTable}`);
  byId("filter").classList.toggle("active", isActive(state.filters));
  showMoment(state, choose);
  showEvent(state, choose);
  document.body.dataset.ready = "true";
}

/** Select an event, and say it to those who cannot see it. */
export function choose(run: number, seq: number): void {
  const focused = document.activeElement?.getAttribute("data-link");
  select(state, run, seq);
  const event = state.page.runs[run].events[seq];
  const count = state.page.runs[run].events.length;
  byId("live").textContent = `Event ${seq} of ${count}, ${seconds(event.time)}: ${said(event)}`;
  redraw();
  if (focused !== null && focused !== undefined) {
    requestAnimationFrame(() => byId("event-title").focus());
  }
}

/** Draw again after a change of what is shown. */
function changed(): void {
  if (state.isTable) {
    showTables(state, choose);
  }
  redraw();
}

function toggleTable(): void {
  state.isTable = !state.isTable;
  changed();
}

function toggleFilters(): void {
  const form = byId("filters");
  form.hidden = !form.hidden;
  byId("filter").setAttribute("aria-expanded", `${!form.hidden}`);
  if (!form.hidden) {
    form.querySelector<HTMLElement>("button")?.focus();
  }
}

const THEMES = ["auto", "light", "dark"];

function nextTheme(): void {
  const root = document.documentElement;
  const next = THEMES[(THEMES.indexOf(root.dataset.theme ?? "auto") + 1) % THEMES.length];
  root.dataset.theme = next;
  byId("theme").textContent = `Theme: ${next}`;
}

function openHelp(): void {
  byId<HTMLDialogElement>("help").showModal();
}

function introduce(): void {
  const [run] = state.page.runs;
  const isOne = state.page.runs.length === 1;
  const name = isOne ? `Run ${run.name}` : `Runs ${state.page.runs.map((one) => one.name).join(" and ")}`;
  document.title = `${name} – FSAR ledger`;
  byId("title").textContent = name;
  const facts = run.about.filter(([label]) => !["kind", "source"].includes(label)).map(([label, value]) =>
    ["architecture", "configuration", "scenario"].includes(label) ? value : `${label} ${value}`,
  );
  byId("facts").textContent = isOne
    ? [...facts, `${run.events.length} events`, seconds(run.end, 1), ...clock(run, 0)].join(" · ")
    : differenceText();
  byId("run-id").textContent = state.page.runs.map((one) => one.run).join("\n");
  const ledgers = state.page.runs.filter((each, at) => at === 0 || each.root !== run.root);
  byId("standing").replaceChildren(
    ...ledgers.map((one) => {
      const rows = one.isVerified ? "rows compared with this root" : "rows not compared with this root";
      return element("p", {}, `${one.ledger}: ${one.size} events, root ${one.root}, ${rows}`);
    }),
  );
}

/** Take the run as it is by now, and keep what is looked at: the end stays in view where it was. */
function grow(text: string): void {
  const before = endOf(state.page);
  state.page = load(text);
  const by = endOf(state.page) - before;
  if (state.to >= before) {
    move(state, state.from === 0 ? 0 : state.from + by, state.to + by);
  }
  introduce();
  showLegend(state.page);
  if (!byId("filters").contains(document.activeElement)) {
    showFilters(state.page, state.filters, changed);
  }
  changed();
}

/**
 * Let who opened the page feed it with a run that goes on: the console of a service, which serves the page without an
 * origin of its own. A page with an origin is not fed, since anybody can open it.
 */
function listenToOpener(): void {
  if (window.opener !== null && window.origin === "null") {
    const { port1, port2 } = new MessageChannel();
    port1.onmessage = (event) => grow(`${event.data}`);
    window.opener.postMessage("drawn", "*", [port2]);
  }
}

function differenceText(): string {
  const first = state.page.firstDifference;
  return first === null
    ? "No difference: the same events at the same times with the same causes"
    : `The first difference is event ${first}. Up to there both have the same events, times and causes.`;
}

introduce();
showLegend(state.page);
showFilters(state.page, state.filters, changed);
byId("table").addEventListener("click", toggleTable);
byId("filter").addEventListener("click", toggleFilters);
byId("theme").addEventListener("click", nextTheme);
byId("open-help").addEventListener("click", openHelp);
listen({ state, drawings, redraw, choose, scale: () => scaleOf(state, byId("timeline").clientWidth) });
document.addEventListener("keydown", (event) =>
  onKey(event, { state, redraw, choose, toggleTable, toggleFilters, nextTheme, openHelp }),
);
new ResizeObserver(redraw).observe(byId("stage"));
render();
listenToOpener();
