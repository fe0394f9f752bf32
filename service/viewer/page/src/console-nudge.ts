// Nudges by keys and direct moves: what moves, what the rest does meanwhile, who gets the motion, and what became of it.
import { KEYS, MOVES, MoveForm, readKey } from "./console-pose-data";
import { choice, labelled } from "./console-fields";
import { section } from "./console-judge";
import { button, el, figure } from "./dom";

const PERIOD_MS = 100;  // between two nudges of a key that is held
const FORCE_N = 20;

export interface Moved { plan_id: string; trajectory_sha256: string; duration_s: number; planning_time_s: number; revision: number }
type Give = (order: string, values: Record<string, unknown>) => Promise<Moved>;

export class NudgePanel {
  readonly element = el("div", "nudges");
  private readonly said = el("p", "said");
  private readonly keys = el("input");
  private readonly touch = el("input");
  private readonly pieces = el("input", "text");
  private readonly force = el("input", "text");
  private readonly hand: HTMLSelectElement;
  private readonly other: HTMLSelectElement;
  private readonly free: HTMLSelectElement;
  private readonly to: HTMLSelectElement;
  private held: string | null = null;
  private isUnderWay = false;

  constructor(private readonly give: Give, private readonly middle: () => number[] | null) {
    this.hand = choice("hand", [["left", "left"], ["right", "right"], ["both", "both"]], "right", () => {});
    this.other = choice("other hand", [["keep", "keeps its pose"], ["lock", "keeps its joints"], ["free", "is free"]], "keep", () => {});
    this.free = choice("free axis", [["none", "none"], ["x", "x"], ["y", "y"], ["z", "z"], ["all", "any turn"]], "none", () => {});
    this.to = choice("who gets the motion", [["ghost", "ghost"], ["robot", "robot and ghost"]], "ghost", () => this.showRecipient());
    this.keys.type = this.touch.type = "checkbox";
    this.force.value = String(FORCE_N);
    this.pieces.placeholder = "pieces, by name";
    const grid = el("div", "keys", ...KEYS.map(({ key, text, does }) => button("key", text, `${does}: key ${text}`, () => void this.press(key))));
    const touches = el("div", "touches", labelled("pieces", this.pieces), labelled("force [N]", this.force));
    touches.hidden = true;
    this.touch.addEventListener("change", () => { touches.hidden = !this.touch.checked; });
    this.element.append(
      section("Nudge", labelled("motion goes to", this.to), labelled("hand", this.hand), labelled("other hand", this.other), labelled("free axis", this.free),
        el("label", "placed", this.touch, " the hand may touch"), touches, el("label", "placed", this.keys, " keys of the keyboard nudge"), grid,
        el("p", "soft", "1 cm or 0.02 rad each; letters turn a hand about its own axes, capitals about the world's"), this.said),
      this.forms(),
    );
    this.showRecipient();
    window.addEventListener("keydown", this.down);
    window.addEventListener("keyup", this.up);
    window.addEventListener("blur", this.release);
  }

  private showRecipient(): void { this.element.classList.toggle("to-robot", this.to.value === "robot"); }

  private readonly down = (event: KeyboardEvent): void => {
    const isTyping = event.target instanceof HTMLElement && event.target.matches("input:not([type=checkbox]), textarea, select");
    if (!this.keys.checked || isTyping || event.ctrlKey || event.metaKey || event.altKey) return;
    const key = readKey(event.key);
    if (key === null) return;
    event.preventDefault();
    if (event.repeat) return;
    this.held = key;
    void this.hold(key);
  };

  private readonly up = (event: KeyboardEvent): void => { if (readKey(event.key)?.toLowerCase() === this.held?.toLowerCase()) this.held = null; };
  private readonly release = (): void => { this.held = null; };

  // Nudge as long as a key is held, as fast as motions arrive and at most ten times a second.
  private async hold(key: string): Promise<void> {
    let isFirst = true;
    while (isFirst || this.held === key) {
      isFirst = false;
      const begun = performance.now();
      if (!(await this.press(key))) return;
      await new Promise((resolve) => setTimeout(resolve, Math.max(0, PERIOD_MS - performance.now() + begun)));
    }
  }

  // Give one nudge; whether it was carried out.
  private press(key: string): Promise<boolean> {
    const touch = this.touch.checked ? { touch_force_n: Number(this.force.value), touch_pieces: this.pieces.value.split(/[\s,]+/).filter(Boolean) } : {};
    return this.send("nudge", { key, ...this.hands(), middle: this.hand.value === "both" ? this.middle() : null, ...touch });
  }

  private hands(): Record<string, unknown> {
    return { hand: this.hand.value, other_hand: this.other.value, free_axis: this.free.value };
  }

  private async send(order: string, values: Record<string, unknown>): Promise<boolean> {
    if (this.isUnderWay) return false;
    this.isUnderWay = true;
    try {
      const moved = await this.give(order, { ...values, to: this.to.value });
      const who = this.to.value === "robot" ? "robot and ghost have" : "the ghost has";
      this.say(`${who} motion ${moved.trajectory_sha256.slice(0, 8)}, ${figure(moved.duration_s, "s")}, planned in ${figure(moved.planning_time_s, "s")}`, "good");
      return true;
    } catch (error) {
      this.say(error instanceof Error ? error.message : String(error), "bad");
      return false;
    } finally {
      this.isUnderWay = false;
    }
  }

  // Direct moves, each a form.
  private forms(): HTMLElement {
    const body = el("div");
    const show = (name: string): void => body.replaceChildren(this.form(MOVES.find((move) => move.name === name)!));
    const kind = choice("move", MOVES.map(({ name }) => [name, name]), MOVES[0].name, show);
    show(MOVES[0].name);
    return el("details", "group", el("summary", "", "Move by numbers"), labelled("move", kind), body);
  }

  private form(move: MoveForm): HTMLElement {
    const inputs = move.fields.map(([name, unit, value]) => {
      const input = el("input", "text");
      input.value = value;
      return { input, field: labelled(unit ? `${name} [${unit}]` : name, input), count: value.split(",").length, name };
    });
    const go = button("yes", "Move", `Plan and give this ${move.name}`, () => {
      const values = inputs.map(({ input }) => input.value.split(/[\s,;]+/).filter(Boolean).map(Number));
      const wrong = inputs.findIndex(({ count }, k) => values[k].length !== count || !values[k].every(Number.isFinite));
      if (wrong >= 0) return this.say(`${inputs[wrong].name}: expected ${inputs[wrong].count === 1 ? "a number" : "3 numbers"}, got "${inputs[wrong].input.value}"`, "bad");
      void this.send("move", { step: move.make(values, this.hands()) });
    });
    return el("div", "", ...inputs.map(({ field }) => field), el("div", "buttons", go));
  }

  private say(text: string, kind: string): void {
    this.said.textContent = text;
    this.said.className = `said ${kind}`;
  }

  close(): void {
    this.held = null;
    window.removeEventListener("keydown", this.down);
    window.removeEventListener("keyup", this.up);
    window.removeEventListener("blur", this.release);
  }
}
