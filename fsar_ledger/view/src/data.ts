/**
 * The data of the page, as `fsar_ledger/view/__init__.py` writes it, and runs as the page uses them.
 *
 * Units: microseconds.
 */

export interface Lane {
  index: number;
  name: string;
  about: string;
}

export interface Span {
  index: number;
  lane: number;
  track: string;
  kind: string;
  about: string;
  text: string;
  start: number;
  /** The end of the record where `isOpen`. */
  end: number;
  isOpen: boolean;
  seq: number;
  until: number | null;
}

export interface Arrow {
  from: number;
  to: number;
  sent: number;
  arrived: number;
  seq: number;
  kind: string;
}

export interface LedgerEvent {
  seq: number;
  time: number;
  cause: number | null;
  type: string;
  concern: string;
  fields: [string, unknown][];
  sender: string | null;
  receiver: string | null;
  message: string;
  note: string | null;
  action: string | null;
  lane: number;
  task: string | null;
  isRoutine: boolean;
}

export interface Run {
  index: number;
  run: string;
  /** What names the run in a command. */
  name: string;
  ledger: string;
  size: number;
  root: string;
  isVerified: boolean;
  /** Milliseconds from 1970 to run time 0; null: the run does not know when it began. */
  epoch: number | null;
  notObserved: string[];
  about: [string, string][];
  lanes: Lane[];
  spans: Span[];
  arrows: Arrow[];
  events: LedgerEvent[];
  effects: Map<number, number[]>;
  end: number;
}

export interface Page {
  runs: Run[];
  isSame: boolean;
  firstDifference: number | null;
}

type Stored = {
  run: string;
  name: string;
  ledger: string;
  size: number;
  root: string;
  is_verified: boolean;
  epoch: string | null;
  not_observed: string[];
  about: [string, string][];
  lanes: [string, string][];
  types: [string, string | null, string[]][];
  words: [string | null, string | null, string, string | null, string | null][];
  payloads: [number, ...unknown[]][];
  events: [number, number | null, number, number, number, string | null][];
  spans: [number, string, string, string, string, number, number | null, number, number | null][];
  arrows: [number, number, number, number, number, string][];
};

/** The concern of events that describe the run itself. */
export const NO_CONCERN = "run";

export const CONCERN_OF_TRACK: Record<string, string> = {
  task: "task",
  work: "execution",
  queue: "execution",
  recovery: "recovery",
  request: "request",
  call: "supervision",
  claim: "authority",
  policy: "policy",
  told: "knowledge",
  world: "world",
};

export function load(text: string): Page {
  const document = JSON.parse(text) as { runs: Stored[]; is_same: boolean; first_difference: number | null };
  return {
    runs: document.runs.map(runOf),
    isSame: document.is_same,
    firstDifference: document.first_difference,
  };
}

function runOf(stored: Stored, index: number): Run {
  let time = 0;
  const events = stored.events.map(([delta, cause, payload, words, lane, task], seq): LedgerEvent => {
    time += delta;
    const [kind, ...values] = stored.payloads[payload];
    const [type, concern, names] = stored.types[kind];
    const [sender, receiver, message, note, action] = stored.words[words];
    return {
      seq,
      time,
      cause,
      type,
      concern: concern ?? NO_CONCERN,
      fields: names.map((name, at) => [name, values[at]]),
      sender,
      receiver,
      message,
      note,
      action,
      lane,
      task,
      isRoutine: type.startsWith("Routine"),
    };
  });
  const effects = new Map<number, number[]>();
  for (const event of events) {
    if (event.cause !== null) {
      effects.set(event.cause, [...(effects.get(event.cause) ?? []), event.seq]);
    }
  }
  return {
    index,
    run: stored.run,
    name: stored.name,
    ledger: stored.ledger,
    size: stored.size,
    root: stored.root,
    isVerified: stored.is_verified,
    epoch: stored.epoch === null ? null : Date.parse(stored.epoch),
    notObserved: stored.not_observed,
    about: stored.about,
    lanes: stored.lanes.map(([name, about], at) => ({ index: at, name, about })),
    spans: stored.spans.map(([lane, track, kind, about, words, start, end, seq, until], at) => ({
      index: at,
      lane,
      track,
      kind,
      about,
      text: words,
      start,
      end: end ?? time,
      isOpen: end === null,
      seq,
      until,
    })),
    arrows: stored.arrows.map(([from, to, sent, arrived, seq, kind]) => ({ from, to, sent, arrived, seq, kind })),
    events,
    effects,
    end: time,
  };
}

/** The task of an action: `A1-1` for `A1-1/2.1`. */
export function taskOf(about: string): string {
  return about.split("/")[0];
}

export function seconds(time: number, digits = 3): string {
  return `${(time / 1e6).toFixed(digits)} s`;
}

/** The time of day, in UTC, where the run knows when it began. */
export function clock(run: Run, time: number): string[] {
  return run.epoch === null ? [] : [new Date(run.epoch + time / 1e3).toISOString()];
}

/** The chain of causes of an event, from the event itself back to the first. */
export function chain(run: Run, seq: number): number[] {
  const found = [seq];
  for (let cause = run.events[seq].cause; cause !== null; cause = run.events[cause].cause) {
    found.push(cause);
  }
  return found;
}

/** The last event at or before this time, or the first of all. */
export function eventAt(run: Run, time: number): number {
  let low = 0;
  let high = run.events.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (run.events[middle].time <= time) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  return Math.max(0, low - 1);
}

/** What held at this time, lane by lane. */
export function heldAt(run: Run, time: number): Span[] {
  return run.spans.filter((span) => span.start <= time && (time < span.end || (span.isOpen && time >= span.end)));
}

/** Who tells whom, or does, what. */
export function said(event: LedgerEvent): string {
  const names =
    event.receiver !== null && event.receiver !== event.sender
      ? `${event.sender ?? "?"} → ${event.receiver}`
      : (event.sender ?? "?");
  return `${names} ${event.message}${event.note === null ? "" : ` (${event.note})`}`;
}
