/** Where things are drawn: a lane has a row for each track that it uses, with as many lines as overlap. */

import { type Run, type Span } from "./data";
import { type Filters, showsLane, showsSpan } from "./filters";

export interface Row {
  track: string;
  top: number;
  height: number;
}

export interface LanePlace {
  lane: number;
  top: number;
  bottom: number;
  rows: Row[];
  /** The middle of the row of events. */
  ticks: number;
}

export interface Layout {
  lanes: Map<number, LanePlace>;
  spans: { span: Span; top: number; height: number }[];
  height: number;
}

/** The tracks from top to bottom, and the height of a bar. */
const TRACKS: [string, number][] = [
  ["task", 15],
  ["work", 19],
  ["queue", 7],
  ["recovery", 9],
  ["request", 8],
  ["call", 16],
  ["claim", 4],
  ["policy", 8],
  ["told", 6],
  ["world", 8],
];
/** The least height of a row, so that its name is legible, and the gap below it. */
const ROW_LEAST = 9;
const GAP = 4;
const LINES_MOST = 4;
const TICKS = 10;
const PADDING = 7;

/** Place what is shown of a run; `heading` is the height of a label above each lane. */
export function layoutOf(run: Run, filters: Filters, heading: number): Layout {
  const lanes = new Map<number, LanePlace>();
  const placed: Layout["spans"] = [];
  const byRow = new Map<string, Span[]>();
  for (const span of run.spans.filter((one) => showsSpan(filters, run, one))) {
    const row = `${span.lane} ${span.track}`;
    byRow.set(row, [...(byRow.get(row) ?? []), span]);
  }
  let top = 0;
  for (const lane of run.lanes) {
    if (!showsLane(filters, run, lane.index)) {
      continue;
    }
    const rows: Row[] = [];
    let at = top + PADDING + heading;
    for (const [track, height] of TRACKS) {
      const spans = byRow.get(`${lane.index} ${track}`) ?? [];
      if (spans.length === 0) {
        continue;
      }
      const lines = linesOf(spans);
      const count = Math.max(...lines) + 1;
      const taken = Math.max(ROW_LEAST, count * (height + 1) - 1);
      const first = at + (taken - count * (height + 1) + 1) / 2;
      spans.forEach((span, index) => placed.push({ span, top: first + lines[index] * (height + 1), height }));
      rows.push({ track, top: at, height: taken });
      at += taken + GAP;
    }
    const least = heading > 0 ? heading + 26 : 26 + 14 * aboutLines(lane.about).length;
    const bottom = Math.max(at + TICKS + PADDING, top + least);
    lanes.set(lane.index, { lane: lane.index, top, bottom, rows, ticks: bottom - PADDING - TICKS / 2 });
    top = bottom;
  }
  return { lanes, spans: placed, height: top };
}

/** What is said below the name of a lane: role and team, then the place. */
export function aboutLines(about: string): string[] {
  const [role, team, ...place] = about.split(", ");
  return [[role, team].filter(Boolean).join(", "), place.join(", ")].filter((line) => line !== "");
}

/** The line of each span in its row, so that none covers another; from the last line on they may. */
function linesOf(spans: Span[]): number[] {
  const free: number[] = [];
  return spans.map((span) => {
    const found = free.findIndex((end) => end <= span.start);
    const line = found >= 0 ? found : Math.min(free.length, LINES_MOST - 1);
    free[line] = Math.max(span.end, free[line] ?? 0);
    return line;
  });
}
