/** What to show: robots, one task, concerns, routine. */

import { CONCERN_OF_TRACK, type LedgerEvent, type Page, type Run, type Span, taskOf } from "./data";
import { byId, element } from "./dom";

export interface Filters {
  hiddenRobots: Set<string>;
  hiddenConcerns: Set<string>;
  task: string | null;
  isRoutineHidden: boolean;
}

export function noFilters(): Filters {
  return { hiddenRobots: new Set(), hiddenConcerns: new Set(), task: null, isRoutineHidden: false };
}

export function isActive(filters: Filters): boolean {
  const hidden = filters.hiddenRobots.size + filters.hiddenConcerns.size;
  return hidden > 0 || filters.task !== null || filters.isRoutineHidden;
}

export function showsLane(filters: Filters, run: Run, lane: number): boolean {
  return lane < 0 || !filters.hiddenRobots.has(run.lanes[lane].name);
}

export function showsEvent(filters: Filters, run: Run, event: LedgerEvent): boolean {
  return (
    showsLane(filters, run, event.lane) &&
    !filters.hiddenConcerns.has(event.concern) &&
    (filters.task === null || event.task === filters.task) &&
    !(filters.isRoutineHidden && event.isRoutine)
  );
}

export function showsSpan(filters: Filters, run: Run, span: Span): boolean {
  return (
    showsLane(filters, run, span.lane) &&
    !filters.hiddenConcerns.has(CONCERN_OF_TRACK[span.track]) &&
    (filters.task === null || !isAboutTask(span) || taskOf(span.about) === filters.task)
  );
}

/** Windows, obstructions and the like belong to no task, and stay. */
function isAboutTask(span: Span): boolean {
  return ["task", "work", "queue", "recovery", "request", "call", "claim"].includes(span.track);
}

/** Fill the form of filters; `changed` is called after each change. */
export function showFilters(page: Page, filters: Filters, changed: () => void): void {
  const events = page.runs.flatMap((run) => run.events);
  const robots = unique(page.runs.flatMap((run) => run.lanes.map((lane) => lane.name))).filter((name) =>
    name.startsWith("robot/"),
  );
  const concerns = unique(events.map((event) => event.concern)).sort();
  const tasks = unique(events.flatMap((event) => (event.task === null ? [] : [event.task])));
  const chosen = element("select", { id: "task" }, element("option", { value: "" }, "every task"));
  chosen.append(...tasks.map((task) => element("option", { value: task }, task)));
  chosen.value = filters.task ?? "";
  chosen.addEventListener("change", () => {
    filters.task = chosen.value === "" ? null : chosen.value;
    changed();
  });
  byId("filters").replaceChildren(
    group("Robots", robots, filters.hiddenRobots, (name) => name.replace("robot/", ""), changed),
    element("div", { class: "group" }, element("label", { for: "task" }, "Task"), chosen),
    group("Concerns", concerns, filters.hiddenConcerns, (name) => name, changed),
    element("div", { class: "group" }, routine(filters, changed), everything(page, filters, changed)),
  );
}

function group(
  title: string,
  names: string[],
  hidden: Set<string>,
  label: (name: string) => string,
  changed: () => void,
): HTMLElement {
  const chips = names.map((name) =>
    chip(label(name), !hidden.has(name), (isOn) => {
      if (isOn) {
        hidden.delete(name);
      } else {
        hidden.add(name);
      }
      changed();
    }),
  );
  const none = element("button", { type: "button", class: "plain" }, "None");
  none.addEventListener("click", () => {
    names.forEach((name) => hidden.add(name));
    chips.forEach((one) => one.setAttribute("aria-pressed", "false"));
    changed();
  });
  const head = element("span", {}, title);
  return element("div", { class: "group", role: "group", "aria-label": title }, head, ...chips, none);
}

function routine(filters: Filters, changed: () => void): HTMLElement {
  return chip("routine", !filters.isRoutineHidden, (isOn) => {
    filters.isRoutineHidden = !isOn;
    changed();
  });
}

function everything(page: Page, filters: Filters, changed: () => void): HTMLElement {
  const button = element("button", { type: "button", id: "everything", class: "plain" }, "Show everything");
  button.addEventListener("click", () => {
    Object.assign(filters, noFilters());
    showFilters(page, filters, changed);
    changed();
    byId("everything").focus();
  });
  return button;
}

function chip(label: string, isOn: boolean, toggled: (isOn: boolean) => void): HTMLElement {
  const button = element("button", { type: "button", class: "chip", "aria-pressed": `${isOn}` }, label);
  button.addEventListener("click", () => {
    const isNowOn = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", `${isNowOn}`);
    toggled(isNowOn);
  });
  return button;
}

function unique(names: string[]): string[] {
  return [...new Set(names)];
}
