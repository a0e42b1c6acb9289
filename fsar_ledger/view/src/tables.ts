/** Everything as tables: what readers of screens, printers and searches get. */

import { type Run, said, seconds } from "./data";
import { byId, element } from "./dom";
import { showsEvent, showsSpan } from "./filters";
import { words } from "./panels";
import { type State } from "./state";

const AT_ONCE = 200;

export function showTables(state: State, choose: (run: number, seq: number) => void): void {
  byId("tables").replaceChildren(
    ...state.page.runs.flatMap((run) => [eventsOf(state, run, choose), spansOf(state, run, choose)]),
  );
}

function eventsOf(state: State, run: Run, choose: (run: number, seq: number) => void): HTMLElement {
  const events = run.events.filter((event) => showsEvent(state.filters, run, event));
  const lines = events.map((event) => () => [
    jump(`${event.seq}`, () => choose(run.index, event.seq)),
    seconds(event.time),
    event.type,
    said(event),
    event.action ?? "",
    event.cause === null ? "" : `${event.cause}`,
  ]);
  const names = ["event", "time", "type", "what", "action", "caused by"];
  return table(`Run ${run.name}: ${events.length} events`, names, lines);
}

function spansOf(state: State, run: Run, choose: (run: number, seq: number) => void): HTMLElement {
  const spans = run.spans.filter((span) => showsSpan(state.filters, run, span));
  const lines = spans.map((span) => () => [
    jump(`${span.seq}`, () => choose(run.index, span.seq)),
    run.lanes[span.lane].name,
    words(span),
    seconds(span.start),
    span.isOpen ? "end of the record" : seconds(span.end),
  ]);
  return table(`Run ${run.name}: ${spans.length} bars`, ["from event", "lane", "what held", "from", "until"], lines);
}

function jump(label: string, chosen: () => void): HTMLElement {
  const button = element("button", { type: "button", class: "link" }, label);
  button.addEventListener("click", chosen);
  return button;
}

/** A table that makes its lines when they are asked for, since there may be ten thousand. */
function table(caption: string, names: string[], lines: (() => (string | HTMLElement)[])[]): HTMLElement {
  const head = element("tr", {}, ...names.map((name) => element("th", { scope: "col" }, name)));
  const body = element("tbody");
  const found = element("table", {}, element("caption", {}, caption), element("thead", {}, head), body);
  const more = element("button", { type: "button", class: "plain" });
  let shown = 0;
  const show = (): void => {
    for (const line of lines.slice(shown, shown + AT_ONCE)) {
      body.append(element("tr", {}, ...line().map((cell) => element("td", {}, cell))));
    }
    shown = Math.min(lines.length, shown + AT_ONCE);
    more.textContent = `Show more of ${lines.length}`;
    more.hidden = shown === lines.length;
  };
  more.addEventListener("click", show);
  show();
  const frame = element("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": caption }, found);
  return element("div", { class: "table" }, frame, more);
}
