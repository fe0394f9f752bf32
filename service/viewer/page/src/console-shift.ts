// Targets of feet and hands that the operator displaces while a plan runs: by sliders or by numbers, three axes of the world.
import { RobotState, UNDER_WAY } from "./console-data";
import { button, el, words } from "./dom";

const MOST_M = 0.3;   // what the server takes
const STEP_M = 0.005;
const AXES = ["x", "y", "z"];

export class ShiftPanel {
  readonly element = el("details", "shift");
  private readonly link = el("select", "choice");
  private readonly axes = AXES.map((name) => this.axis(name));
  private links: string[] = [];
  private state: RobotState | null = null;
  private isAwaited = false;
  private isChanged = false;

  // The order gives a link and a displacement [m], and returns once it is answered.
  constructor(private readonly give: (link: string, offset_m: number[]) => Promise<void>) {
    this.link.setAttribute("aria-label", "foot or hand");
    this.link.addEventListener("change", () => this.read());
    const back = button("", "As planned", "Take the displacement back", () => this.set([0, 0, 0]));
    this.element.append(
      el("summary", "", "Shift a target"),
      el("div", "axes", this.link, ...this.axes.map(({ element }) => element), back,
        el("span", "soft", "m in world axes, at most 0.3 m; a shifted target is outside of the plan's certificate")),
    );
  }

  private axis(name: string): { element: HTMLElement; slide: HTMLInputElement; number: HTMLInputElement } {
    const [slide, number] = [el("input"), el("input", "text")];
    slide.type = "range";
    number.type = "number";
    for (const input of [slide, number]) {
      Object.assign(input, { min: String(-MOST_M), max: String(MOST_M), step: String(STEP_M), value: "0" });
      input.setAttribute("aria-label", `${name} [m]`);
    }
    slide.addEventListener("input", () => { number.value = slide.value; this.pump(); });
    number.addEventListener("change", () => { slide.value = number.value; this.pump(); });
    return { element: el("label", "axis", name, slide, number), slide, number };
  }

  private set(offset: number[]): void {
    this.axes.forEach(({ slide, number }, k) => { slide.value = number.value = String(offset[k]); });
    this.pump();
  }

  // What the robot has of the chosen link.
  private read(): void {
    const offset = this.state?.shifts[this.link.value] ?? [0, 0, 0];
    this.axes.forEach(({ slide, number }, k) => { slide.value = number.value = String(offset[k]); });
  }

  // Give the newest displacement once the one before it is answered.
  private pump(): void {
    this.isChanged = true;
    if (this.isAwaited) return;
    this.isChanged = false;
    this.isAwaited = true;
    void this.give(this.link.value, this.axes.map(({ number }) => Number(number.value))).finally(() => {
      this.isAwaited = false;
      if (this.isChanged) this.pump();
    });
  }

  show(state: RobotState, mayOrder: boolean): void {
    this.state = state;
    this.element.hidden = !state.has_control || !UNDER_WAY.includes(state.mode) || state.shiftable.length === 0;
    this.element.classList.toggle("off", !mayOrder);
    const links = [...state.shiftable].reverse();  // hands first: a foot that stands carries the robot
    if (this.links.join() === links.join()) return;
    this.links = links;
    this.link.replaceChildren(...this.links.map((name) => {
      const option = el("option", "", words(name));
      option.value = name;
      return option;
    }));
    this.read();
  }
}
