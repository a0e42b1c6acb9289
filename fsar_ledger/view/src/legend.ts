/** What the bars and marks mean: only those that occur. */

import { type Page } from "./data";
import { byId, drawn, element } from "./dom";

const ROWS: [string, string, string, number, [string, string][]][] = [
  ["task", "task", "a robot's task, from its arrival to its end", 12, [["task", "task"]]],
  [
    "work",
    "work",
    "what a robot does",
    12,
    [
      ["approaching", "approaching"],
      ["running", "running"],
      ["held", "held by policy"],
      ["paused", "paused"],
      ["failed", "failed"],
      ["helping", "helping"],
    ],
  ],
  ["queue", "queue", "waiting for the robot", 6, [["waiting", "waiting"]]],
  [
    "recovery",
    "recovery",
    "a failure, by the level that deals with it",
    9,
    [
      ["local", "local"],
      ["peer", "peer"],
      ["fleet", "fleet"],
      ["human", "human"],
    ],
  ],
  [
    "request",
    "request",
    "what the robot has asked of others",
    7,
    [
      ["open", "open"],
      ["accepted", "accepted"],
    ],
  ],
  [
    "call",
    "call",
    "a supervisor is asked",
    12,
    [
      ["review", "review"],
      ["recovery", "recovery"],
      ["ordering", "ordering"],
    ],
  ],
  [
    "claim",
    "claim",
    "who holds authority",
    4,
    [
      ["execution", "execution"],
      ["override", "override"],
      ["audit", "audit"],
    ],
  ],
  [
    "policy",
    "policy",
    "windows and rules that do not allow",
    7,
    [
      ["deny", "deny"],
      ["review", "review"],
    ],
  ],
  [
    "told",
    "told",
    "the rule of the fleet that the robot was told",
    5,
    [
      ["deny", "deny"],
      ["review", "review"],
    ],
  ],
  [
    "world",
    "world",
    "what happens to it",
    7,
    [
      ["obstructed", "obstructed"],
      ["degraded", "degraded"],
      ["off", "off, off shift"],
      ["unlinked", "link down"],
      ["offline", "listed as offline"],
    ],
  ],
];

const MARKS: [string, string][] = [
  ["tick plain", "event"],
  ["tick routine", "routine"],
  ["tick grave", "denied, held, failed"],
];

const ARROWS: [string, string][] = [
  ["request", "request"],
  ["refusal", "refusal"],
  ["call", "call"],
  ["help", "help"],
  ["message", "other message"],
];

export function showLegend(page: Page): void {
  const spans = new Set(page.runs.flatMap((run) => run.spans.map((span) => `${span.track} ${span.kind}`)));
  const arrows = new Set(page.runs.flatMap((run) => run.arrows.map((arrow) => arrow.kind)));
  const groups = ROWS.flatMap(([track, name, about, height, kinds]) => {
    const used = kinds.filter(([kind]) => spans.has(`${track} ${kind}`));
    const items = used.map(([kind, label]) => item(swatch(track, kind, height), label));
    return items.length === 0 ? [] : [group(name, about, items)];
  });
  const marks = MARKS.map(([kind, label]) => item(mark(kind), label));
  groups.push(group("ticks", "one for each event", marks));
  const messages = ARROWS.filter(([kind]) => arrows.has(kind)).map(([kind, label]) => item(arrow(kind), label));
  if (messages.length > 0) {
    groups.push(group("arrows", "messages between lanes", messages));
  }
  byId("legend").replaceChildren(...groups);
}

function group(name: string, about: string, items: HTMLElement[]): HTMLElement {
  const title = element("dt", {}, name, element("span", {}, about));
  return element("div", {}, title, element("dd", {}, ...items));
}

function item(sign: SVGSVGElement, label: string): HTMLElement {
  return element("span", { class: "item" }, sign, label);
}

function swatch(track: string, kind: string, height: number): SVGSVGElement {
  const rounded = Math.min(2.5, height / 2);
  const rect = { class: `bar ${track} ${kind}`, x: 0.5, y: 7 - height / 2, width: 21, height, rx: rounded };
  return drawn("svg", { width: 22, height: 14, "aria-hidden": "true" }, drawn("rect", rect));
}

function mark(kind: string): SVGSVGElement {
  const reach = kind.endsWith("routine") ? 2.5 : 5;
  const path = drawn("path", { class: kind, d: `M5 ${7 - reach}v${2 * reach}` });
  return drawn("svg", { width: 10, height: 14, "aria-hidden": "true" }, path);
}

function arrow(kind: string): SVGSVGElement {
  const line = drawn("path", { class: `arrow ${kind}`, d: "M1 7H16" });
  const head = drawn("path", { class: `head ${kind}`, d: "M22 7L15 4.2L15 9.8Z" });
  return drawn("svg", { width: 22, height: 14, "aria-hidden": "true" }, line, head);
}
