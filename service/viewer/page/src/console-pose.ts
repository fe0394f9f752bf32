// The pose tab: a ghost that is led by hand or by keys, what stops it, its presets, and what becomes of the pose.
import { Job, OLD_SCAN_S, RobotState, ScanCloud, Tabs, ago } from "./console-data";
import { choice, labelled, recall, remember } from "./console-fields";
import { section } from "./console-judge";
import { Link, points } from "./console-link";
import { Moved, NudgePanel } from "./console-nudge";
import { Measured, OpenedPose, Pose, Target, middleOfHands } from "./console-pose-data";
import { PoseView } from "./console-pose-view";
import { RobotStrip } from "./console-robot";
import { button, el, figure, words } from "./dom";

const NONE = "";
const MOST_AGAIN = 40;  // events that lead a pose on after the pointer was let go

const saidBy = (error: unknown): string => (error instanceof Error ? error.message : String(error));

export class PoseTab {
  readonly element = el("div", "tab");
  view: PoseView | null = null;
  pose: Pose | null = null;
  opened: OpenedPose | null = null;
  readonly nudges: NudgePanel;
  private readonly said = el("p", "said");
  private readonly stops = el("ul", "why");
  private readonly figures = el("p", "soft");
  private readonly handles = el("div", "chips");
  private readonly presets = el("div", "chips");
  private readonly progress = el("div", "progress");
  private readonly undo = button("no", "Undo", "Back to the pose before", () => void this.order("pose_go", { way: "undo" }));
  private readonly redo = button("no", "Redo", "Take the latest undo back", () => void this.order("pose_go", { way: "redo" }));
  private readonly plan = button("yes", "Plan", "Plan a motion from the first pose to this one", () => void this.ask());
  readonly name = el("input", "text");
  private robot: string;
  private posture: string;
  private scan: string;
  private asked = 0;
  private job: Job | null = null;
  private measured: { names: string[]; pose: Measured } | null = null;
  // Of the drag: what was asked for last, whether its answer is awaited, and how often it is led on.
  private targets: Target[] = [];
  private awaited = 0;
  private isChanged = false;
  private isReleased = false;
  private again = 0;

  constructor(
    private readonly tabs: Tabs, readonly link: Link, private readonly strip: RobotStrip, private readonly host: HTMLElement,
    private readonly onJob: (job: Job) => void,
  ) {
    const remembered = recall("robot");
    this.robot = tabs.robots.find(({ name }) => name === remembered)?.name ?? tabs.robots.find(({ name }) => name === "atlas")?.name ?? tabs.robots[0]?.name ?? "";
    this.posture = recall(`posture-${this.robot}`) ?? NONE;
    this.scan = tabs.scans.find(({ name }) => name === recall("scan"))?.name ?? NONE;
    this.nudges = new NudgePanel((order, values) => this.give(order, values), () => (this.opened && this.view ? middleOfHands(this.opened.drawing, this.view.ghost.placed) : null));
    this.build();
    void this.open();
  }

  private build(): void {
    const { tabs } = this;
    const robots = tabs.robots.map(({ name }): [string, string] => [name, name]);
    const scans: [string, string][] = [[NONE, "no scan"], ...tabs.scans.map(({ name, age_s }): [string, string] => [name, `${name} · ${ago(age_s)} old`])];
    const robot = choice("robot", robots, this.robot, (name) => { this.robot = name; this.posture = NONE; remember("robot", name); void this.open(); });
    const scan = choice("scan", scans, this.scan, (name) => { this.scan = name; void this.open(); });
    const turn = choice("gizmo", [["move", "moves"], ["turn", "turns"]], "move", (value) => this.view?.turn(value === "turn"));
    this.name.placeholder = "name";
    const keep = button("no", "Keep as task", "Keep this pose as a task file, which is a tab then", () => void this.keep());
    const save = button("no", "Save", "Save this pose as a state file, with all bits", () => void this.save());
    const load = el("input");
    load.type = "file";
    load.accept = ".json";
    load.hidden = true;
    load.addEventListener("change", () => void this.load(load));
    const read = button("no", "Load", "Take the pose of a state file", () => load.click());
    this.element.append(
      section("Robot and scan", labelled("robot", robot), labelled("scan", scan)),
      section("Lead", el("p", "soft", "Click on a green handle, or choose it here; with Shift several are led together."), this.handles, labelled("the gizmo", turn),
        this.said, this.stops, this.figures, el("div", "buttons", this.undo, this.redo)),
      section("Presets", this.presets),
      section("This pose", el("div", "buttons", this.plan), this.progress, el("div", "buttons", this.name, keep), el("div", "buttons", save, read, load)),
      this.nudges.element,
    );
  }

  // Open a session where robot and scan are chosen; the ghost stands as the robot does at the start.
  private async open(): Promise<void> {
    const asked = ++this.asked;
    this.view?.close();
    [this.view, this.opened, this.pose] = [null, null, null];
    this.awaited = 0;
    this.say(this.scan === NONE ? "opening" : "reading the scan", "");
    const where = { scan: this.scan || null, robot: this.robot, posture: this.posture || null };
    try {
      const scan = this.scan === NONE ? null : await this.link.order<ScanCloud>("scan", { ...where, ...points() });
      const opened = await this.link.order<OpenedPose>("pose_open", where);
      if (asked !== this.asked || !this.element.isConnected) return;
      this.opened = opened;
      this.view = new PoseView(opened, scan?.cloud ?? null, this.host);
      this.view.onDrag = (targets) => this.lead(targets);
      this.view.onRelease = () => { this.isReleased = true; this.again = 0; this.pump(); };
      this.view.onChoose = () => this.listHandles();
      if (this.measured) this.view.showMeasured(this.measured.names, this.measured.pose);
      this.listHandles();
      this.listPresets();
      this.take(opened.pose);
      if (scan && scan.age_s > OLD_SCAN_S) this.say(`this scan is ${ago(scan.age_s)} old`, "fair");
      else this.say("", "");
    } catch (error) {
      if (asked === this.asked) this.say(saidBy(error), "bad");
    }
  }

  private listHandles(): void {
    const { opened, view } = this;
    if (!opened || !view) return;
    this.handles.replaceChildren(...opened.links.map((link) => {
      const stands = opened.feet.includes(link);
      const chip = button(view.chosen.includes(link) ? "on" : "", words(link), stands ? `${link} stands and carries the robot` : `Lead ${link}`, () => view.choose([link]));
      chip.disabled = stands;
      return chip;
    }));
  }

  private listPresets(): void {
    const postures = this.tabs.robots.find(({ name }) => name === this.robot)?.postures ?? [];
    this.presets.replaceChildren(...postures.map((posture) => button("", words(posture), `Put the ghost into ${posture}`, () => void this.order("pose_set", { start: this.preset(posture) }))));
  }

  // A posture where the robot stands.
  private preset(posture: string): Record<string, unknown> {
    return { posture };
  }

  private lead(targets: Target[]): void {
    this.targets = targets;
    [this.isChanged, this.isReleased] = [true, false];
    this.pump();
  }

  // Send the newest drag once the one before it is answered: the slowest line gets whole poses, and no queue.
  private pump(): void {
    if (this.awaited !== 0 || this.targets.length === 0) return;
    if (!this.isChanged && !this.isReleased) return;
    const isLast = this.isReleased && !this.isChanged && this.again >= MOST_AGAIN;
    this.isChanged = false;
    this.awaited = -1;
    void this.order("pose_drag", { targets: this.targets, is_last: isLast }).then((number) => { this.awaited = this.awaited === -1 ? number : this.awaited; if (number === 0) this.awaited = 0; });
    if (isLast) this.targets = [];
  }

  // Take a pose that the server sends; a drag that has not arrived is led on until nothing changes any more.
  take(pose: Pose): void {
    const before = this.pose;
    this.pose = pose;
    this.view?.show(pose);
    this.undo.disabled = pose.undo === 0;
    this.redo.disabled = pose.redo === 0;
    this.tell(pose);
    if (this.awaited === 0 || !pose.is_checked) return;
    this.awaited = 0;
    if (this.isReleased && !this.isChanged) {
      const isStill = before !== null && before.revision === pose.revision;
      this.again = isStill || pose.stops.length === 0 ? MOST_AGAIN : this.again + 1;
    } else if (before?.revision !== pose.revision && pose.stops.length > 0) this.isChanged = true;
    this.pump();
  }

  // Whether no event of a drag is awaited or still to be sent.
  get isAtRest(): boolean { return this.awaited === 0 && this.targets.length === 0; }

  private tell(pose: Pose): void {
    this.stops.replaceChildren(...pose.stops.map(({ text }) => el("li", "", text)));
    const parts = [
      ["clearance", pose.clearance_m, "m"], ["balance", pose.balance_margin_m, "m"], ["torque", pose.torque_share, "1"],
    ] as const;
    this.figures.textContent = parts.filter(([, value]) => value !== null).map(([name, value, unit]) => `${name} ${figure(value, unit)}`).join(" · ");
    if (pose.refusal) this.say(pose.refusal, "bad");
    else if (this.said.classList.contains("bad")) this.say("", "");
  }

  // An event of the bridge about the pose.
  hear(event: Record<string, unknown>): void {
    if (event.session !== this.opened?.session) return;  // of another page
    if (typeof event.problem === "string") {
      this.say(event.problem, "bad");
      this.handles.replaceChildren(button("", "Begin again here", "Open a pose of this page", () => void this.open()));
    } else this.take(event as unknown as Pose);
  }

  showMeasured(names: string[], pose: Measured): void {
    if (names.length === 0) return;
    this.measured = { names, pose };
    this.view?.showMeasured(names, pose);
  }

  hearRobot(state: RobotState): void { if (state.is_there) this.showMeasured(state.joint_names, state); }

  private give(order: string, values: Record<string, unknown>): Promise<Moved> {
    if (values.to === "robot" && !this.strip.mayOrder) return Promise.reject(new Error("take control of the robot first"));
    return this.ordered<Moved>(order, { ...values, revision: this.strip.revision });
  }

  // An order about the pose that this page has opened.
  ordered<T>(name: string, values: Record<string, unknown> = {}): Promise<T> {
    return this.link.order<T>(name, { ...values, session: this.opened?.session ?? 0 });
  }

  private async order(name: string, values: Record<string, unknown>): Promise<number> {
    try {
      return (await this.ordered<{ number: number }>(name, values)).number;
    } catch (error) {
      this.say(saidBy(error), "bad");
      return 0;
    }
  }

  private async ask(): Promise<void> {
    try {
      this.follow(await this.ordered<Job>("pose_plan"));
    } catch (error) {
      this.say(saidBy(error), "bad");
    }
  }

  // What becomes of the plan to this pose.
  follow(job: Job): void {
    if (job.task !== "pose" || (this.job && job.job < this.job.job)) return;
    if (!this.job && job.state === "finished") return;
    this.job = job;
    const isOver = ["finished", "failed", "stopped"].includes(job.state);
    this.plan.disabled = !isOver;
    const stop = button("no", "Stop", "Stop this plan", () => void this.link.order("cancel", { job: job.job }).catch(() => {}));
    this.progress.replaceChildren(...(isOver ? [] : [el("span", "soft", [job.state, job.step].filter(Boolean).join(" · ")), stop]));
    if (job.state === "failed" || job.state === "stopped") this.say(job.error || "the plan was stopped", "bad");
    this.onJob(job);
  }

  private async keep(): Promise<void> {
    try {
      const { path } = await this.ordered<{ path: string }>("pose_keep", { name: this.name.value.trim() });
      this.say(`kept in ${path}`, "good");
    } catch (error) {
      this.say(saidBy(error), "bad");
    }
  }

  private async save(): Promise<void> {
    try {
      const state = await this.ordered<Record<string, unknown>>("pose_read");
      const link = el("a");
      link.href = URL.createObjectURL(new Blob([JSON.stringify(state)], { type: "application/json" }));
      link.download = `${this.name.value.trim() || "pose"}.json`;
      link.click();
      URL.revokeObjectURL(link.href);
    } catch (error) {
      this.say(saidBy(error), "bad");
    }
  }

  private async load(input: HTMLInputElement): Promise<void> {
    const file = input.files?.[0];
    input.value = "";
    if (!file) return;
    try {
      await this.order("pose_set", { start: JSON.parse(await file.text()) as unknown });
    } catch {
      this.say(`${file.name}: is no JSON; expected a state file that Save wrote`, "bad");
    }
  }

  private say(text: string, kind: string): void {
    this.said.textContent = text;
    this.said.className = `said ${text ? kind : ""}`;
  }

  close(): void {
    this.asked += 1;
    this.nudges.close();
    this.view?.close();
    this.view = null;
  }
}
