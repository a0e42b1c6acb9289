/** Mouse and touch: click, drag, zoom, and words under the pointer. */

import { type Drawing, type Scale } from "./chart";
import { type LedgerEvent, type Run, said, seconds } from "./data";
import { byId } from "./dom";
import { showsEvent } from "./filters";
import { overviewTime } from "./overview";
import { words } from "./panels";
import { endOf, move, point, type State, zoom } from "./state";

interface Surface {
  state: State;
  drawings: Drawing[];
  redraw: () => void;
  choose: (run: number, seq: number) => void;
  scale: () => Scale;
}

const STILL = 4;
const NEAR = 8;

export function listen(surface: Surface): void {
  onRuns(surface);
  onOverview(surface);
  onButtons(surface);
  byId("timeline").addEventListener("wheel", (event) => onWheel(event, surface), { passive: false });
}

function onRuns({ state, drawings, redraw, choose, scale }: Surface): void {
  const runs = byId("runs");
  let held: { x: number; from: number; to: number; isMoved: boolean } | null = null;
  runs.addEventListener("pointerdown", (event) => {
    if (event.button === 0) {
      held = { x: event.clientX, from: state.from, to: state.to, isMoved: false };
    }
  });
  window.addEventListener("pointermove", (event) => {
    if (held === null) {
      return;
    }
    const moved = event.clientX - held.x;
    if (held.isMoved || Math.abs(moved) > STILL) {
      held.isMoved = true;
      hide();
      const perPixel = (held.to - held.from) / scale().width;
      move(state, held.from - moved * perPixel, held.to - moved * perPixel);
      redraw();
    }
  });
  window.addEventListener("pointerup", (event) => {
    const isClick = held !== null && !held.isMoved && runs.contains(event.target as Node);
    held = null;
    if (isClick) {
      const found = under(event, state, drawings, scale());
      if (found.seq !== null) {
        choose(found.run.index, found.seq);
      } else {
        state.active = found.run.index;
        state.selected = null;
        point(state, found.time);
        redraw();
      }
    }
  });
  window.addEventListener("pointercancel", () => {
    held = null;
  });
  runs.addEventListener("pointermove", (event) => {
    if (held === null && event.pointerType !== "touch") {
      say(event, under(event, state, drawings, scale()).text);
    }
  });
  runs.addEventListener("pointerleave", hide);
  // Not dblclick: the picture that was pressed may be drawn anew before the button is up, and then nothing was clicked.
  runs.addEventListener("mousedown", (event) => {
    if (event.button === 0 && event.detail === 2) {
      held = null;
      const box = runs.getBoundingClientRect();
      zoom(state, 3, scale().time(event.clientX - box.left));
      redraw();
    }
  });
}

interface Found {
  run: Run;
  time: number;
  seq: number | null;
  text: string | null;
}

/** What is at this place: a bar, an arrow, a tick nearby, or only a time. */
function under(event: PointerEvent, state: State, drawings: Drawing[], scale: Scale): Found {
  const target = event.target as Element;
  const picture = target.closest<HTMLElement>("[data-run]");
  const index = Number(picture?.dataset.run ?? 0);
  const run = state.page.runs[index];
  const box = drawings[index].svg.getBoundingClientRect();
  const [x, y] = [event.clientX - box.left, event.clientY - box.top];
  const time = scale.time(x);
  const tick = nearest(state, run, drawings[index], scale, x, y);
  if (tick !== null) {
    return { run, time, seq: tick.seq, text: `${seconds(tick.time)}  ${said(tick)}` };
  }
  const bar = target.getAttribute("data-span");
  if (bar !== null) {
    const span = run.spans[Number(bar)];
    const until = span.isOpen ? "the end" : seconds(span.end);
    return { run, time, seq: span.seq, text: `${words(span)}\n${seconds(span.start)} to ${until}` };
  }
  const seq = target.getAttribute("data-seq");
  return seq === null
    ? { run, time, seq: null, text: null }
    : { run, time, seq: Number(seq), text: said(run.events[Number(seq)]) };
}

function nearest(state: State, run: Run, drawing: Drawing, scale: Scale, x: number, y: number): LedgerEvent | null {
  const place = [...drawing.layout.lanes.values()].find((one) => Math.abs(y - one.ticks) <= NEAR);
  if (place === undefined || x < scale.left) {
    return null;
  }
  let best: LedgerEvent | null = null;
  let least = NEAR;
  for (const event of run.events) {
    const distance = Math.abs(scale.x(event.time) - x);
    if (event.lane === place.lane && distance < least && showsEvent(state.filters, run, event)) {
      [best, least] = [event, distance];
    }
  }
  return best;
}

function say(event: PointerEvent, text: string | null): void {
  const tip = byId("tip");
  tip.hidden = text === null;
  if (text !== null) {
    tip.textContent = text;
    const left = Math.min(event.clientX + 12, document.documentElement.clientWidth - tip.offsetWidth - 8);
    tip.style.left = `${Math.max(8, left)}px`;
    tip.style.top = `${event.clientY + 18}px`;
  }
}

function hide(): void {
  byId("tip").hidden = true;
}

/** Drag over the strip to choose what is in view; click to go there. */
function onOverview({ state, redraw }: Surface): void {
  const strip = byId("overview");
  const time = (event: PointerEvent): number => {
    const box = strip.getBoundingClientRect();
    return overviewTime(state, box.width, event.clientX - box.left);
  };
  let began: { x: number; time: number } | null = null;
  strip.addEventListener("pointerdown", (event) => {
    began = { x: event.clientX, time: time(event) };
    strip.setPointerCapture(event.pointerId);
  });
  strip.addEventListener("pointermove", (event) => {
    if (began !== null && Math.abs(event.clientX - began.x) > STILL) {
      const now = time(event);
      move(state, Math.min(began.time, now), Math.max(began.time, now));
      redraw();
    }
  });
  strip.addEventListener("pointerup", (event) => {
    if (began !== null && Math.abs(event.clientX - began.x) <= STILL) {
      const half = (state.to - state.from) / 2;
      state.selected = null;
      point(state, began.time);
      move(state, state.cursor - half, state.cursor + half);
      redraw();
    }
    began = null;
  });
}

function onButtons({ state, redraw }: Surface): void {
  const acts: Record<string, () => void> = {
    "zoom-in": () => zoom(state, 2, state.cursor),
    "zoom-out": () => zoom(state, 0.5, state.cursor),
    whole: () => move(state, 0, endOf(state.page)),
  };
  for (const [id, act] of Object.entries(acts)) {
    byId(id).addEventListener("click", () => {
      act();
      redraw();
    });
  }
}

function onWheel(event: WheelEvent, { state, redraw, scale }: Surface): void {
  const isZoom = event.ctrlKey || event.metaKey;
  const isSideways = event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY);
  if (!isZoom && !isSideways) {
    return;
  }
  event.preventDefault();
  const box = byId("runs").getBoundingClientRect();
  if (isZoom) {
    zoom(state, 2 ** (-event.deltaY / 200), scale().time(event.clientX - box.left));
  } else {
    const by = ((event.deltaX || event.deltaY) / scale().width) * (state.to - state.from);
    move(state, state.from + by, state.to + by);
  }
  redraw();
}
