/** The whole run in a strip: how much happens when, which part is in view, and a way to move there. */

import { drawn } from "./dom";
import { isNarrow, GUTTER } from "./chart";
import { endOf, type State } from "./state";

const HEIGHT = 40;

export function overview(state: State, width: number): SVGSVGElement {
  const left = isNarrow(width) ? 8 : GUTTER;
  const inner = Math.max(40, width - left - 12);
  const end = endOf(state.page);
  const x = (time: number): number => left + (time / end) * inner;
  const svg = drawn("svg", { width, height: HEIGHT, viewBox: `0 0 ${width} ${HEIGHT}`, "aria-hidden": "true" });
  svg.append(drawn("rect", { class: "strip", x: left, y: 0, width: inner, height: HEIGHT, rx: 4 }));
  if (!isNarrow(width)) {
    svg.append(drawn("text", { x: 12, y: HEIGHT / 2 + 4 }, "whole run"));
  }
  const bins = Math.min(240, Math.floor(inner / 3));
  state.page.runs.forEach((run, index) => {
    const counts = new Array<number>(bins).fill(0);
    for (const event of run.events) {
      if (event.time > 0 && !event.isRoutine) {
        counts[Math.min(bins - 1, Math.floor((event.time / end) * bins))] += 1;
      }
    }
    const room = HEIGHT / state.page.runs.length;
    const most = Math.max(1, ...counts);
    const bars = counts.map((count, bin) => {
      const middle = left + ((bin + 0.5) / bins) * inner;
      const height = Math.max(1.5, Math.sqrt(count / most) * (room - 5));
      return count === 0 ? "" : `M${middle.toFixed(1)} ${(index + 1) * room - 1}v${(-height).toFixed(1)}`;
    });
    svg.append(drawn("path", { class: "density", d: bars.join(""), "stroke-width": Math.max(1.5, inner / bins - 1) }));
  });
  const [from, to] = [x(state.from), x(state.to)];
  if (to - from < inner - 2) {
    svg.append(
      drawn("rect", { class: "outside", x: left, y: 0, width: from - left, height: HEIGHT }),
      drawn("rect", { class: "outside", x: to, y: 0, width: left + inner - to, height: HEIGHT }),
      drawn("rect", { class: "window", x: from, y: 0.75, width: Math.max(to - from, 3), height: HEIGHT - 1.5, rx: 3 }),
    );
  }
  const cursor = x(state.cursor);
  svg.append(drawn("line", { class: "cursor", x1: cursor, x2: cursor, y1: 0, y2: HEIGHT }));
  return svg;
}

/** The time at this place of the strip. */
export function overviewTime(state: State, width: number, x: number): number {
  const left = isNarrow(width) ? 8 : GUTTER;
  const inner = Math.max(40, width - left - 12);
  return (Math.max(0, Math.min(x - left, inner)) / inner) * endOf(state.page);
}
