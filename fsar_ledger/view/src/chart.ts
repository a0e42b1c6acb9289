/** The picture of one run: lanes with bars, ticks and arrows, drawn for the times in view. */

import { type Arrow, chain, type LedgerEvent, type Run, seconds, type Span } from "./data";
import { drawn, element } from "./dom";
import { isActive, showsEvent } from "./filters";
import { aboutLines, type LanePlace, type Layout, layoutOf, type Row } from "./layout";
import { type State, timeOf } from "./state";

export const GUTTER = 172;
const NARROW = 640;
const LETTER = 6;
/** Events that are drawn in a colour of their own, by the end of their type's name. */
const GRAVE = ["Denied", "Failed", "Withheld", "Held", "Revoked", "Abandoned", "Rejected", "Voided"];

export interface Scale {
  left: number;
  width: number;
  x: (time: number) => number;
  time: (x: number) => number;
}

export function isNarrow(width: number): boolean {
  return width < NARROW;
}

export function scaleOf(state: State, width: number): Scale {
  const left = isNarrow(width) ? 8 : GUTTER;
  const inner = Math.max(40, width - left - 12);
  const perPixel = (state.to - state.from) / inner;
  return {
    left,
    width: inner,
    x: (time) => left + (time - state.from) / perPixel,
    time: (x) => state.from + (x - left) * perPixel,
  };
}

export interface Drawing {
  svg: SVGSVGElement;
  layout: Layout;
}

/** Draw the run as wide as this. */
export function draw(state: State, run: Run, width: number): Drawing {
  const scale = scaleOf(state, width);
  const layout = layoutOf(run, state.filters, isNarrow(width) ? 16 : 0);
  const svg = drawn("svg", { width, height: layout.height, viewBox: `0 0 ${width} ${layout.height}` });
  svg.setAttribute("aria-hidden", "true");
  const clip = `view-${run.index}`;
  const area = { x: scale.left, y: 0, width: scale.width, height: layout.height };
  svg.append(
    drawn("defs", {}, drawn("clipPath", { id: clip }, drawn("rect", area))),
    ...[...layout.lanes.values()].map((place) => background(run, place, width)),
    drawn("g", { class: "grid", "clip-path": `url(#${clip})` }, ...gridOf(state, scale, layout.height)),
  );
  const inside = drawn("g", { "clip-path": `url(#${clip})` });
  const isQuiet = (arrow: Arrow): boolean => arrow.kind === "message";
  inside.append(
    ...run.arrows.filter(isQuiet).flatMap((arrow) => arrowOf(state, run, arrow, layout, scale)),
    ...layout.spans.flatMap(({ span, top, height }) => bar(state, span, top, height, scale)),
    ...[...layout.lanes.values()].flatMap((place) => ticks(state, run, place, scale)),
    ...run.arrows.filter((arrow) => !isQuiet(arrow)).flatMap((arrow) => arrowOf(state, run, arrow, layout, scale)),
    ...selection(state, run, layout, scale),
    ...marks(state, run, layout.height, scale),
  );
  svg.append(inside, ...[...layout.lanes.values()].flatMap((place) => names(run, place, width, scale)));
  return { svg, layout };
}

function background(run: Run, place: LanePlace, width: number): SVGElement {
  const height = place.bottom - place.top;
  return drawn("rect", { class: `lane ${kindOfLane(run, place)}`, x: 0, y: place.top, width, height });
}

function kindOfLane(run: Run, place: LanePlace): string {
  return run.lanes[place.lane].name.split("/")[0];
}

/** The names of a lane and of its rows; where there is little room, that of the lane alone. */
function names(run: Run, place: LanePlace, width: number, scale: Scale): SVGElement[] {
  const { name, about } = run.lanes[place.lane];
  const [kind, rest] = [kindOfLane(run, place), name.slice(name.indexOf("/") + 1)];
  const label = drawn("text", { class: "name", x: 12, y: place.top + (isNarrow(width) ? 14 : 18) }, rest);
  label.append(drawn("tspan", { class: "kind", dx: 6 }, rest === kind ? "" : kind));
  if (isNarrow(width)) {
    return [label];
  }
  const more = aboutLines(about).map((line, at) => drawn("text", { x: 12, y: place.top + 33 + 14 * at }, line));
  return [label, ...more, ...place.rows.map((row) => rowName(row, scale))];
}

function rowName(row: Row, scale: Scale): SVGElement {
  const y = row.top + Math.min(row.height, 20) / 2 + 3.4;
  return drawn("text", { class: "row", x: scale.left - 9, y }, row.track);
}

function bar(state: State, span: Span, top: number, height: number, scale: Scale): SVGElement[] {
  if (span.end < state.from || span.start > state.to) {
    return [];
  }
  const left = Math.max(scale.x(span.start), scale.left - 4);
  const right = Math.min(scale.x(span.end), scale.left + scale.width + 4);
  const width = Math.max(right - left, 1.5);
  const rounded = Math.min(2.5, height / 2, width / 5);
  const rect = drawn("rect", {
    class: `bar ${span.track} ${span.kind}`,
    x: left.toFixed(1),
    y: top,
    width: width.toFixed(1),
    height,
    rx: rounded.toFixed(1),
    "data-span": span.index,
  });
  const text = span.track === "work" ? span.text : span.track === "call" ? span.kind : span.about;
  const room = Math.floor((width - 8) / LETTER);
  if (height < 13 || room < 3 || text === "") {
    return [rect];
  }
  const shown = text.length <= room ? text : `${text.slice(0, room - 1)}…`;
  const y = top + height / 2 + 3.8;
  return [rect, drawn("text", { class: `in ${span.track} ${span.kind}`, x: (left + 5).toFixed(1), y }, shown)];
}

/** One path for each kind of tick, however many events: those that share a pixel are one stroke. */
function ticks(state: State, run: Run, place: LanePlace, scale: Scale): SVGElement[] {
  const paths: Record<string, string[]> = { routine: [], plain: [], grave: [] };
  const last: Record<string, number> = {};
  for (const event of run.events) {
    if (event.lane !== place.lane || event.time < state.from || event.time > state.to) {
      continue;
    }
    if (!showsEvent(state.filters, run, event)) {
      continue;
    }
    const kind = kindOf(event);
    const x = Math.round(scale.x(event.time) * 2) / 2;
    if (last[kind] !== x) {
      const reach = kind === "routine" ? 2.5 : 5;
      paths[kind].push(`M${x} ${place.ticks - reach}v${2 * reach}`);
      last[kind] = x;
    }
  }
  return Object.entries(paths)
    .filter(([, parts]) => parts.length > 0)
    .map(([kind, parts]) => drawn("path", { class: `tick ${kind}`, d: parts.join("") }));
}

export function kindOf(event: LedgerEvent): "routine" | "plain" | "grave" {
  if (GRAVE.some((end) => event.type.endsWith(end))) {
    return "grave";
  }
  return event.isRoutine ? "routine" : "plain";
}

function arrowOf(state: State, run: Run, arrow: Arrow, layout: Layout, scale: Scale): SVGElement[] {
  const [from, to] = [layout.lanes.get(arrow.from), layout.lanes.get(arrow.to)];
  const isOut = arrow.arrived < state.from || arrow.sent > state.to;
  if (!from || !to || isOut || !showsEvent(state.filters, run, run.events[arrow.seq])) {
    return [];
  }
  const isDown = to.top > from.top;
  const [x1, x2] = [scale.x(arrow.sent), scale.x(arrow.arrived)];
  const y1 = isDown ? from.ticks : from.top + 5;
  const y2 = isDown ? to.top + 5 : to.ticks;
  const length = Math.hypot(x2 - x1, y2 - y1) || 1;
  const [dx, dy] = [(x2 - x1) / length, (y2 - y1) / length];
  const [bx, by] = [x2 - 6 * dx, y2 - 6 * dy];
  const head = `M${at(x2, y2)}L${at(bx - 2.6 * dy, by + 2.6 * dx)}L${at(bx + 2.6 * dy, by - 2.6 * dx)}Z`;
  return [
    drawn("path", { class: `arrow ${arrow.kind}`, d: `M${at(x1, y1)}L${at(bx, by)}`, "data-seq": arrow.seq }),
    drawn("path", { class: `head ${arrow.kind}`, d: head, "data-seq": arrow.seq }),
  ];
}

function at(x: number, y: number): string {
  return `${x.toFixed(1)} ${y.toFixed(1)}`;
}

/** The selected event, and the chain of its causes as a line through the lanes. */
function selection(state: State, run: Run, layout: Layout, scale: Scale): SVGElement[] {
  if (state.selected === null || state.active !== run.index) {
    return [];
  }
  const points = chain(run, state.selected)
    .filter((seq) => seq > 0)
    .flatMap((seq) => {
      const place = layout.lanes.get(run.events[seq].lane);
      return place ? [[scale.x(run.events[seq].time), place.ticks]] : [];
    });
  const found: SVGElement[] = [];
  if (points.length > 1) {
    found.push(drawn("polyline", { class: "chain", points: points.map(([x, y]) => `${at(x, y)}`).join(" ") }));
    found.push(...points.slice(1).map(([x, y]) => drawn("circle", { class: "chain", cx: x, cy: y, r: 2.5 })));
  }
  if (points.length > 0) {
    found.push(drawn("circle", { class: "selected", cx: points[0][0], cy: points[0][1], r: 6 }));
  }
  return found;
}

/** The first difference between two runs, and the cursor. */
function marks(state: State, run: Run, height: number, scale: Scale): SVGElement[] {
  const found: SVGElement[] = [];
  if (state.page.firstDifference !== null) {
    const x = scale.x(timeOf(run, state.page.firstDifference));
    found.push(drawn("line", { class: "difference", x1: x, x2: x, y1: 0, y2: height }));
  }
  const x = scale.x(state.cursor);
  found.push(drawn("line", { class: "cursor", x1: x, x2: x, y1: 0, y2: height }));
  return found;
}

export function gridOf(state: State, scale: Scale, height: number): SVGElement[] {
  return times(state, scale).map((time) => {
    const x = Math.round(scale.x(time)) + 0.5;
    return drawn("line", { x1: x, x2: x, y1: 0, y2: height });
  });
}

/** Round times for the axis, some 90 pixels apart. */
export function times(state: State, scale: Scale): number[] {
  const least = ((state.to - state.from) / scale.width) * 90;
  const power = 10 ** Math.floor(Math.log10(least));
  const step = Math.max(1, [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= least) ?? 1);
  const found: number[] = [];
  for (let time = Math.ceil(state.from / step) * step; time <= state.to; time += step) {
    found.push(time);
  }
  return found;
}

/** The axis, with the cursor's time and, for two runs, the flag of their first difference. */
export function axis(state: State, width: number): SVGSVGElement {
  const scale = scaleOf(state, width);
  const top = state.page.firstDifference === null ? 0 : 10;
  const height = 34 + top;
  const svg = drawn("svg", { width, height, viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" });
  const steps = times(state, scale);
  const digits = steps.length > 1 ? Math.max(0, Math.ceil(-Math.log10((steps[1] - steps[0]) / 1e6) - 1e-9)) : 3;
  const shown = scale.x(state.cursor);
  const first = state.page.firstDifference;
  const flagged = first === null ? null : scale.x(timeOf(state.page.runs[0], first));
  for (const time of steps) {
    const x = scale.x(time);
    svg.append(drawn("line", { class: "mark", x1: x, x2: x, y1: height - 5, y2: height }));
    if (Math.abs(x - shown) > 58 && (flagged === null || Math.abs(x - flagged) > 24)) {
      svg.append(drawn("text", { class: "time", x, y: top + 25 }, seconds(time, digits)));
    }
  }
  if (flagged !== null && flagged >= scale.left && flagged <= scale.left + scale.width) {
    const isLeft = flagged > scale.left + scale.width / 2;
    const x = flagged + (isLeft ? -5 : 5);
    svg.append(
      drawn("path", { class: "flag", d: `M${flagged} 0v${height}` }),
      drawn("text", { class: "flag", x, y: 14, "text-anchor": isLeft ? "end" : "start" }, "first difference"),
    );
  }
  if (shown >= scale.left - 1 && shown <= scale.left + scale.width + 1) {
    const x = Math.min(Math.max(shown, scale.left + 36), scale.left + scale.width - 36);
    svg.append(
      drawn("rect", { class: "flag-cursor", x: x - 36, y: top + 13, width: 72, height: 17, rx: 3 }),
      drawn("text", { class: "time-cursor", x, y: top + 25.5 }, seconds(state.cursor)),
    );
  }
  return svg;
}

/** The heading above a run: its name, what it is, and what is hidden. */
export function heading(state: State, run: Run): HTMLElement {
  const facts = run.about.map(([, value]) => value);
  const title = element("h2", {}, `Run ${run.name}`);
  const about = element("p", { class: "facts" }, [...facts.slice(0, 3), ...seed(run)].join(" · "));
  const found = element("div", { class: "run-heading" }, title, about);
  if (isActive(state.filters)) {
    found.append(element("p", { class: "note" }, "filtered"));
  }
  return found;
}

function seed(run: Run): string[] {
  const named = new Map(run.about);
  return ["seed", "fleet size"].flatMap((name) => (named.has(name) ? [`${name} ${named.get(name)}`] : []));
}
