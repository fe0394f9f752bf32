// The strip on top of every screen: what the robot does, who has control, orders, and what changed behind the operator.
import { Job, RUNNING, RobotState, UNDER_WAY, sayRobot } from "./console-data";
import { Link } from "./console-link";
import { Measured } from "./console-pose-data";
import { ShiftPanel } from "./console-shift";
import { button, el, words } from "./dom";

const SPEEDS = [0.1, 0.25, 0.5, 1];
const TONES: Record<string, string> = { running: "good", done: "good", aborted: "bad", fallen: "bad", lost: "bad" };

export class RobotStrip {
  readonly element = el("div", "robot-strip");
  state: RobotState | null = null;
  onState: () => void = () => {};
  onRest: (plan_id: string) => void = () => {};  // once the rest is planned
  private readonly mode = el("b", "mode");
  private readonly line = el("span", "line");
  private readonly holder = el("span", "holder");
  private readonly said = el("span", "said");
  private readonly changed = el("span");
  // Made once: states come while it is pressed.
  private readonly seen = button("", "Seen", "Acknowledge what changed; until then orders are refused", () => void this.order("acknowledge", { seen: this.state?.surprises.length ?? 0 }));
  private readonly alert = el("div", "alert", this.changed, this.seen);
  private readonly speed = el("select", "choice speed");
  private readonly take = button("", "Take control", "Take control of the robot", () => void this.order("take", { takes_over: false }));
  private readonly takeOver = button("", "Take over", "Take control from whoever has it", () => void this.order("take", { takes_over: true }));
  private readonly release = button("", "Release", "Give control back", () => void this.command("release_control"));
  private readonly pause = button("", "Pause", "The plan's clock comes to rest", () => void this.command("pause"));
  private readonly resume = button("", "Resume", "The plan's clock goes on", () => void this.command("resume"));
  private readonly abort = button("", "Go back", "Back to the last pose in balance, where the execution ends", () => void this.command("abort"));
  private readonly retreat = button("", "Retreat", "Back to the plan's start, or to the first rest since the hands let something go; refused while they press", () => void this.command("retreat"));
  private readonly stop = button("stop", "Stop", "The robot comes to rest, and the execution ends there", () => void this.command("stop"));
  private readonly shift = new ShiftPanel((link, offset_m) => this.command("shift", { link, offset_m }));
  private readonly shifted = el("span");
  private readonly rest = button("", "Plan the rest", "Plan the rest from where the robot is, with what was shifted displaced as far", () => void this.planRest());
  private readonly uncertified = el("div", "uncertified", this.shifted, this.rest);
  private job: Job | null = null;  // of the rest, while it is planned
  private answered = 0;  // revision of the newest answer, which may come before its state

  constructor(private readonly link: Link) {
    this.speed.setAttribute("aria-label", "speed");
    this.speed.append(...SPEEDS.map((share) => {
      const option = el("option", "", `${100 * share} %`);
      option.value = String(share);
      return option;
    }));
    this.speed.addEventListener("change", () => void this.command("speed", { speed: Number(this.speed.value) }));
    const orders = el("div", "orders", this.take, this.takeOver, this.release, this.speed, this.pause, this.resume, this.abort, this.retreat, this.stop);
    this.element.append(el("div", "now", this.mode, this.line, this.holder, this.said, orders), this.uncertified, this.shift.element, this.alert);
    this.uncertified.hidden = true;
    this.element.hidden = true;
  }

  // Revision that the operator sees.
  get revision(): number { return Math.max(this.answered, this.state?.revision ?? 0); }
  // Whether an order may be given: this page has control, and nothing is left to acknowledge.
  get mayOrder(): boolean { return this.state !== null && this.state.is_there && this.state.has_control && this.state.surprises.length === 0; }

  show(state: RobotState): void {
    this.state = state;
    this.element.hidden = !state.is_there && state.problem === "" && state.surprises.length === 0;
    const { surprises, problem } = state;
    this.alert.hidden = surprises.length === 0 && problem === "";
    this.changed.textContent = [...surprises, problem].filter(Boolean).join("; ");
    this.seen.hidden = surprises.length === 0;
    if (state.is_there) this.showRobot(state);
    this.onState();
  }

  // The robot moved, and nothing else changed.
  showMeasured(measured: Measured): void {
    if (!this.state?.is_there) return;
    Object.assign(this.state, measured);
    this.line.textContent = sayRobot(this.state);
  }

  private showRobot(state: RobotState): void {
    this.mode.textContent = state.mode;
    this.mode.className = `mode ${TONES[state.mode] ?? "fair"}`;
    this.line.textContent = sayRobot(state);
    this.holder.textContent = state.has_control ? "you have control" : state.control ? `${state.control} has control` : "nobody has control";
    this.take.hidden = state.has_control || state.control !== "";
    this.takeOver.hidden = state.has_control || state.control === "";
    this.release.hidden = !state.has_control;
    const isUnderWay = UNDER_WAY.includes(state.mode);
    for (const one of [this.pause, this.resume, this.abort, this.retreat, this.speed]) one.hidden = !state.has_control || !isUnderWay;
    for (const one of [this.pause, this.resume, this.abort, this.retreat, this.speed, this.release]) one.disabled = !this.mayOrder;
    this.pause.hidden ||= state.mode === "paused";
    this.resume.hidden ||= state.mode !== "paused";
    this.stop.hidden = !isUnderWay;
    this.shift.show(state, this.mayOrder);
    const shifted = Object.entries(state.shifts).map(([link, offset]) => `${words(link)} by ${offset.map((value) => value.toFixed(3)).join(", ")} m`);
    this.uncertified.hidden = shifted.length === 0;
    this.shifted.textContent = `UNCERTIFIED: ${shifted.join("; ")} from the plan. To go on with a certificate, take it back, or pause and plan the rest with the object moved; stop before it is executed. `;
    this.rest.disabled = !["paused", "aborted"].includes(state.mode) || this.job !== null;
    if (document.activeElement !== this.speed) this.speed.value = String(SPEEDS.reduce((best, share) => (Math.abs(share - state.speed) < Math.abs(best - state.speed) ? share : best)));
  }

  private command(command: string, more: Record<string, unknown> = {}): Promise<void> {
    return this.order("command", { command, revision: this.revision, ...more });
  }

  // Give an order; its answer, a revision or a refusal, stands in the strip.
  async order(name: string, values: Record<string, unknown>): Promise<void> {
    try {
      const answer = await this.link.order<{ revision?: number }>(name, values);
      if (answer.revision !== undefined) this.answered = Math.max(this.answered, answer.revision);
      this.say(answer.revision === undefined ? "" : `answered: state ${answer.revision}`, "");
    } catch (error) {
      this.say(error instanceof Error ? error.message : String(error), "bad");
    }
  }

  private async planRest(): Promise<void> {
    try {
      this.follow(await this.link.order<Job>("plan_rest"));
    } catch (error) {
      this.say(error instanceof Error ? error.message : String(error), "bad");
    }
  }

  // What becomes of the plan of the rest.
  follow(job: Job): void {
    if (job.task !== "rest" || (this.job === null && !RUNNING.includes(job.state))) return;
    this.job = RUNNING.includes(job.state) ? job : null;
    this.rest.disabled = this.job !== null;
    if (this.job) this.say(["the rest", job.state, job.step].filter(Boolean).join(" · "), "");
    else if (job.state === "finished") this.say(`the rest is planned: ${job.verdict}`, "");
    else this.say(job.error || "the plan of the rest was stopped", "bad");
    if (job.state === "finished") this.onRest(job.plan_id);
  }

  private say(text: string, kind: string): void {
    this.said.textContent = text;
    this.said.className = `said ${kind}`;
  }
}
