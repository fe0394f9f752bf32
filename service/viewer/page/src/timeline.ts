// The time bar: phases by name, waypoints as ticks, failed checks as flags, what is left as curves; drag to scrub.
import { Plot, curves } from "./curves";
import { Result, spanAt } from "./data";
import { button, el, icon, instant, title, words } from "./dom";
import { timeColour } from "./theme";

export interface Player {
  readonly start: number; readonly end: number; readonly time: number; readonly isPlaying: boolean; readonly speed: number;
  seek(t: number): void; toggle(): void; setSpeed(speed: number): void; step(direction: number): void;
  focusGhost(index: number): void; chooseCheck(index: number): void;
}

const PLAY = "M7 4.5v15L20 12z";
const PAUSE = "M6 5h4.5v14H6zM13.5 5H18v14h-4.5z";
const BACK = "M6 5h2.5v14H6zM20 5v14L9.5 12z";
const ON = "M4 5v14l10.5-7zM15.5 5H18v14h-2.5z";

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const hex = (u: number): string => `#${timeColour(u).getHexString()}`;

export class Timeline {
  readonly element: HTMLElement;
  readonly plots: Plot[];
  private readonly track = el("div", "track");
  private readonly head = el("div", "head");
  private readonly clock = el("output", "clock");
  private readonly play: HTMLButtonElement;
  private readonly speed = el("select", "speed");
  private drawn: boolean | null = null;
  private readonly phases: { element: HTMLElement; index: number }[] = [];

  constructor(private readonly result: Result, private readonly player: Player, waypoints: number[]) {
    this.play = button("play", "", "Play or pause (space)", () => player.toggle());
    const back = button("quiet", "", "Previous waypoint (←)", () => player.step(-1));
    const on = button("quiet", "", "Next waypoint (→)", () => player.step(1));
    back.append(icon(BACK));
    on.append(icon(ON));
    this.speed.title = "Speed (+ and −)";
    this.speed.setAttribute("aria-label", "Playback speed");
    for (const speed of SPEEDS) {
      const option = el("option", "", `${speed}×`);
      option.value = String(speed);
      this.speed.append(option);
    }
    this.speed.addEventListener("change", () => player.setSpeed(Number(this.speed.value)));
    this.element = el("footer", "timeline", el("div", "transport", back, this.play, on), this.track, this.clock, this.speed);
    this.plots = curves(result, player.start, player.end);
    this.fill(waypoints);
    this.track.append(this.head);
    this.track.tabIndex = 0;
    this.track.setAttribute("role", "slider");
    this.track.setAttribute("aria-label", "Time");
    this.track.setAttribute("aria-valuemin", player.start.toFixed(2));
    this.track.setAttribute("aria-valuemax", player.end.toFixed(2));
    this.scrub();
    this.update();
  }

  private share(t: number): number {
    return Math.min(Math.max((t - this.player.start) / Math.max(this.player.end - this.player.start, 1e-9), 0), 1);
  }

  private fill(waypoints: number[]): void {
    const bar = el("div", "phases");
    this.result.phases.forEach((phase, index) => {
      const segment = el("div", "phase", el("span", "", words(phase.name)));
      segment.title = `${words(phase.name)}: ${instant(phase.start)} to ${instant(phase.end)}`;
      segment.style.left = `${100 * this.share(phase.start)}%`;
      segment.style.width = `${100 * (this.share(phase.end) - this.share(phase.start))}%`;
      this.phases.push({ element: segment, index });
      bar.append(segment);
    });
    const ticks = el("div", "ticks");
    const stops = Array.from({ length: 9 }, (_, i) => `${hex(i / 8)} ${(100 * i) / 8}%`);
    ticks.style.backgroundImage = `linear-gradient(90deg, ${stops.join(", ")})`;
    waypoints.forEach((t, index) => {
      const tick = el("i", "tick");
      tick.title = `waypoint ${index + 1} of ${waypoints.length} · ${instant(t)}`;
      tick.style.left = `${100 * this.share(t)}%`;
      tick.addEventListener("pointerenter", () => this.player.focusGhost(index));
      tick.addEventListener("pointerleave", () => this.player.focusGhost(-1));
      ticks.append(tick);
    });
    this.track.append(bar, ticks, ...this.plots.map((plot) => plot.element));
    this.result.checks.forEach((check, index) => {
      const t = check.where?.time_s;
      if (check.ok || t === null || t === undefined) return;
      const flag = button("flag", "", `${title(check.name)} at ${instant(t)}`, () => this.player.chooseCheck(index));
      flag.addEventListener("pointerdown", (event) => event.stopPropagation());
      flag.style.left = `${100 * this.share(t)}%`;
      this.track.append(flag);
    });
  }

  private scrub(): void {
    const seek = (event: PointerEvent): void => {
      const rect = this.track.getBoundingClientRect();
      const u = (event.clientX - rect.left) / rect.width;
      this.player.seek(this.player.start + u * (this.player.end - this.player.start));
    };
    this.track.addEventListener("pointerdown", (event) => {
      this.track.setPointerCapture(event.pointerId);
      seek(event);
    });
    this.track.addEventListener("pointermove", (event) => {
      if (this.track.hasPointerCapture(event.pointerId)) seek(event);
    });
  }

  update(): void {
    const { time, end, isPlaying, speed } = this.player;
    this.head.style.left = `${100 * this.share(time)}%`;
    if (this.drawn !== isPlaying) this.play.replaceChildren(icon(isPlaying ? PAUSE : PLAY));
    this.drawn = isPlaying;
    this.speed.value = String(speed);
    this.track.setAttribute("aria-valuenow", time.toFixed(2));
    const current = spanAt(this.result.phases, time);
    const name = el("span", "phase-name", current ? `${words(current.name)} · ` : "");
    this.clock.replaceChildren(name, `${time.toFixed(2)} / ${instant(end)}`);
    for (const { element, index } of this.phases) element.classList.toggle("current", this.result.phases[index] === current);
  }
}
