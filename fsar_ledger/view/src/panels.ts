/** The panels beside the picture: the state at the cursor, and the selected event. */

import { chain, clock, eventAt, heldAt, type LedgerEvent, type Run, said, seconds, type Span } from "./data";
import { byId, element } from "./dom";
import { showsLane, showsSpan } from "./filters";
import { type State } from "./state";

type Choose = (run: number, seq: number) => void;
const LINKS_MOST = 40;
/** The concerns without which nobody knows that a robot is idle. */
const DOINGS = ["execution", "recovery"];
const IN_PART = " in part";

const WORDS: Record<string, (span: Span) => string> = {
  task: (span) => `task ${span.about}`,
  work: (span) => (span.kind === "helping" ? span.text : `${span.kind} ${span.text}`),
  queue: (span) => `waiting ${span.text} ${span.about}`,
  recovery: (span) => `recovery ${span.kind}: ${span.text}`,
  request: (span) => `request ${span.kind}: ${span.text} ${span.about}`,
  call: (span) => `${span.text} ${span.about}`,
  claim: (span) => `claim ${span.kind} ${span.about}`,
  policy: (span) => `${span.text} ${span.about}`,
  told: (span) => span.text,
  world: (span) => span.text,
};

/** Say in words what a span is. */
export function words(span: Span): string {
  return WORDS[span.track](span);
}

export function showMoment(state: State, choose: Choose): void {
  byId("moment-time").textContent = seconds(state.cursor, 6);
  byId("moment").replaceChildren(...state.page.runs.map((run) => momentOf(state, run, choose)));
}

function momentOf(state: State, run: Run, choose: Choose): HTMLElement {
  const found = element("section", { class: "moment-run" });
  if (state.page.runs.length > 1) {
    found.append(element("h3", {}, `Run ${run.name}`));
  }
  const last = run.events[eventAt(run, state.cursor)];
  found.append(element("p", { class: "last" }, "last event ", link(run, last, choose)));
  found.append(...clock(run, state.cursor).map((time) => element("p", { class: "note" }, time)));
  const order = Object.keys(WORDS);
  const held = heldAt(run, state.cursor).sort((one, other) => order.indexOf(one.track) - order.indexOf(other.track));
  const unseen = run.notObserved.filter((concern) => DOINGS.includes(concern.replace(IN_PART, "")));
  const nothing = unseen.length > 0 ? `not observed: ${unseen.join(", ")}` : "idle";
  const list = element("dl", { class: "lanes" });
  for (const lane of run.lanes.filter((one) => showsLane(state.filters, run, one.index))) {
    const mine = held.filter((span) => span.lane === lane.index && showsSpan(state.filters, run, span));
    const chips = mine.map((span) => {
      const chip = element("button", { type: "button", class: `fact ${span.track} ${span.kind}` }, words(span));
      chip.addEventListener("click", () => choose(run.index, span.seq));
      return chip;
    });
    if (chips.length === 0 && !lane.name.startsWith("robot/")) {
      continue;
    }
    const value = element("dd", {}, ...(chips.length > 0 ? chips : [element("span", { class: "nothing" }, nothing)]));
    list.append(element("div", {}, element("dt", {}, lane.name), value));
  }
  found.append(list);
  if (run.notObserved.length > 0) {
    found.append(element("p", { class: "note" }, `Not observed: ${run.notObserved.join(", ")}.`));
  }
  return found;
}

function link(run: Run, event: LedgerEvent, choose: Choose): HTMLButtonElement {
  const button = element("button", { type: "button", class: "link", "data-link": event.seq });
  button.append(element("b", {}, `${event.seq}`), ` ${event.type}`);
  button.addEventListener("click", () => choose(run.index, event.seq));
  return button;
}

export function showEvent(state: State, choose: Choose): void {
  const place = byId("event");
  if (state.selected === null) {
    byId("event-title").textContent = "Event";
    place.replaceChildren(
      element("p", { class: "note" }, "Click a bar, a tick or an arrow, or step through the events with ← and →."),
    );
    return;
  }
  const run = state.page.runs[state.active];
  const event = run.events[state.selected];
  const which = state.page.runs.length > 1 ? ` of run ${run.name}` : "";
  byId("event-title").textContent = `Event ${event.seq}${which}`;
  place.replaceChildren(
    element("p", { class: "type" }, event.type, element("span", { class: "concern" }, event.concern)),
    element("p", { class: "words" }, said(event)),
    element("p", { class: "note" }, [seconds(event.time, 6), ...clock(run, event.time)].join(" · ")),
    ...why(run, event, choose),
    ...effects(run, event, choose),
    ...beside(state, run, event),
    element("h4", {}, "Record"),
    record(allFields(event)),
    element("h4", {}, "Ask the ledger"),
    command(`fsar-ledger why ${run.ledger} ${run.name}:${event.seq}`),
    command(`fsar-ledger prove ${run.ledger} ${run.name}:${event.seq}`),
  );
}

function why(run: Run, event: LedgerEvent, choose: Choose): HTMLElement[] {
  const causes = chain(run, event.seq).slice(1);
  if (causes.length === 0) {
    return [];
  }
  const list = element("ol", { class: "why" });
  for (const seq of causes.slice(0, LINKS_MOST)) {
    const cause = run.events[seq];
    list.append(element("li", {}, link(run, cause, choose), element("span", {}, ` ${seconds(cause.time)}`)));
  }
  const rest = causes.length - LINKS_MOST;
  const more = rest > 0 ? [element("p", { class: "note" }, `and ${rest} more before these`)] : [];
  return [element("h4", {}, "Why: the chain of causes"), list, ...more];
}

function effects(run: Run, event: LedgerEvent, choose: Choose): HTMLElement[] {
  const found = run.effects.get(event.seq) ?? [];
  if (found.length === 0 || event.seq === 0) {
    return [];
  }
  const list = element("ul", { class: "effects" });
  list.append(...found.slice(0, LINKS_MOST).map((seq) => element("li", {}, link(run, run.events[seq], choose))));
  const rest = found.length - LINKS_MOST;
  const more = rest > 0 ? [element("p", { class: "note" }, `and ${rest} more`)] : [];
  return [element("h4", {}, "Led to"), list, ...more];
}

/** At the first difference: what the other run has in this place. */
function beside(state: State, run: Run, event: LedgerEvent): HTMLElement[] {
  if (state.page.firstDifference !== event.seq) {
    return [];
  }
  const other = state.page.runs[1 - run.index];
  const title = element("h4", {}, `First difference: in its place run ${other.name} has`);
  if (event.seq >= other.events.length) {
    return [title, element("p", { class: "note" }, "nothing, it is over")];
  }
  const theirs = other.events[event.seq];
  const mine = new Map(allFields(event).map(([name, value]) => [name, text(value)]));
  const isAlike = theirs.type === event.type;
  const fields = allFields(theirs).filter(([name, value]) => !isAlike || mine.get(name) !== text(value));
  return [title, element("p", {}, `${theirs.type}: ${said(theirs)}`), record(fields)];
}

function allFields(event: LedgerEvent): [string, unknown][] {
  return [["time_us", event.time], ["caused_by", event.cause], ...event.fields];
}

function record(fields: [string, unknown][]): HTMLElement {
  const body = element("tbody");
  for (const [name, value] of fields) {
    const shown = value === null ? element("i", {}, "not on record") : element("span", {}, text(value));
    body.append(element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, shown)));
  }
  return element("table", { class: "record" }, body);
}

function text(value: unknown): string {
  return Array.isArray(value) ? (value.length === 0 ? "none" : value.join(", ")) : `${value}`;
}

function command(words: string): HTMLElement {
  return element("code", { class: "command", tabindex: 0 }, words);
}
