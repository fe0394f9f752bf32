// Starts the console's page: log-in, inbox, task tabs, and what stands beside them.
import { Job, Physics, Plan, ReviewedRow, RobotState, Row, Tabs, ago, standingOfRow } from "./console-data";
import { CameraPanel } from "./console-cameras";
import { choice, labelled } from "./console-fields";
import { Judge, compareRisks, section } from "./console-judge";
import { IS_SLOW, Link, State } from "./console-link";
import { Measured } from "./console-pose-data";
import { PoseTab } from "./console-pose";
import { RobotStrip } from "./console-robot";
import { TabView } from "./console-tab";
import { button, el, words } from "./dom";

interface Settings { version: string; server: string }
const REFRESH_MS = IS_SLOW ? 30_000 : 5000;
const INBOX = "inbox";
const COMPARED_S = 60;  // that a comparison of the scan with what is there is good for
const POSE = "pose tab";  // no task file is called so

const saidBy = (error: unknown): string => (error instanceof Error ? error.message : String(error));

class ConsolePage {
  readonly link: Link;
  readonly robot: RobotStrip;
  private readonly cameras: CameraPanel;
  readonly previewed: string[] = [];  // hashes of the motions that this page has shown, for tests
  tab: TabView | null = null;
  pose: PoseTab | null = null;
  private readonly nav = el("nav", "tabs");
  private readonly list = el("div", "list");
  private readonly view = el("main", "viewport");
  private readonly side = el("aside", "panel");
  private readonly scroll = el("div", "scroll");
  private readonly bar = el("div", "bar-top");
  private readonly login = el("form", "login");
  private readonly where = el("span", "says");
  private frame: HTMLIFrameElement | null = null;
  private beside: HTMLElement | null = null;
  private tabs: Tabs = { tabs: [], robots: [], scans: [], cameras: [] };
  private rows: Row[] = [];
  private active = INBOX;
  private shown = "";
  private nth = 0;
  private problem = "";  // of the connection or the lists
  private notice = "";   // of the last plan that could not be opened

  constructor(private readonly settings: Settings) {
    this.link = new Link(settings.version);
    this.robot = new RobotStrip(this.link);
    this.robot.onRest = (plan_id) => void this.open(plan_id);
    this.cameras = new CameraPanel(this.link);
    document.documentElement.dataset.theme = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
    document.body.classList.add("console");
    const leave = button("", "Log out", "End this session", () => void this.link.logOut().then(() => location.reload()));
    const head = el("header", "top", el("div", "what", el("h1", "", "Console"), this.where), this.nav, el("div", "tools", leave));
    const left = el("aside", "rows", this.cameras.element, this.list, this.openById());
    this.side.append(this.scroll);
    this.bar.hidden = true;
    this.login.hidden = true;
    this.makeLogin();
    document.body.append(head, this.robot.element, this.bar, left, this.view, this.side, this.login);
    this.link.onState = (state, why) => this.tellState(state, why);
    this.link.onEvent = (event) => this.take(event);
    setInterval(() => { if (!document.hidden) void this.refresh(); }, REFRESH_MS);
    void this.link.start();
  }

  private makeLogin(): void {
    const token = el("input", "text");
    token.type = "password";
    token.autocomplete = "off";
    token.setAttribute("aria-label", "token");
    const said = el("p", "said bad");
    const enter = el("button", "yes", "Log in");
    this.login.append(el("h2", "", "Log in"), el("p", "soft", `${this.settings.server} asks for your token, the line that scopt token printed.`), token, enter, said);
    this.login.addEventListener("submit", (event) => {
      event.preventDefault();
      said.textContent = "";
      this.link.logIn(token.value).then(() => { token.value = ""; }, (error: unknown) => { said.textContent = saidBy(error); });
    });
  }

  private openById(): HTMLElement {
    const id = el("input", "text");
    id.placeholder = "Open a plan by its id";
    const form = el("form", "byid", id);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (id.value.trim()) void this.open(id.value.trim()).then(() => { id.value = ""; });
    });
    return form;
  }

  private tellState(state: State, why: string): void {
    this.login.hidden = state !== "login";
    this.where.textContent = state === "open" ? this.settings.server : state === "login" ? "" : state === "connecting" ? `${this.settings.server}, connecting` : `${this.settings.server}, no connection`;
    const text = { lost: `${why}; trying again`, stale: why, open: "", connecting: this.bar.textContent ?? "", login: "" }[state];
    this.say(text, "", state === "stale");
    document.body.classList.toggle("lost", state !== "open");
    if (state === "open") void this.refresh();
  }

  private say(problem: string, notice: string, isStale = false): void {
    [this.problem, this.notice] = [problem, notice];
    const text = problem || notice;
    this.bar.hidden = text === "";
    this.bar.replaceChildren(text, ...(isStale ? [button("", "Load again", "Load this page again", () => location.reload())] : []));
  }

  private take(event: Record<string, unknown>): void {
    if (event.event === "job") this.follow(event as unknown as Job);
    if (event.event === "robot") {
      this.robot.show(event as unknown as RobotState);
      this.cameras.show(this.robot.state?.phase ?? "");
      this.pose?.hearRobot(event as unknown as RobotState);
    }
    if (event.event === "measured") {
      this.robot.showMeasured(event as unknown as Measured);
      this.pose?.showMeasured(this.robot.state?.joint_names ?? [], event as unknown as Measured);
    }
    if (event.event === "pose") this.pose?.hear(event);
    if (event.event === "hello") for (const job of event.jobs as Job[]) this.follow(job);
  }

  private follow(job: Job): void {
    this.tab?.follow(job);
    this.pose?.follow(job);
    this.robot.follow(job);
  }

  private async refresh(): Promise<void> {
    if (this.link.state !== "open") return;
    try {
      const tabs = IS_SLOW && this.tabs.tabs.length > 0 ? this.tabs : this.link.order<Tabs>("tabs");
      [this.rows, this.tabs] = await Promise.all([this.link.order<Row[]>("inbox"), tabs]);
      if (this.link.state === "open") this.say("", this.notice);
    } catch (error) {
      // A caller of the wrong role, or a planning server that does not answer: the console itself does.
      if (this.link.state === "open") this.say(saidBy(error), this.notice);
    }
    this.tab?.hearScans(this.tabs.scans);
    this.cameras.list(this.tabs.cameras);
    this.drawTabs();
    this.drawRows();
  }

  private drawTabs(): void {
    const waiting = this.rows.filter((row) => row.needs_decision).length;
    const inbox = button(this.active === INBOX ? "on" : "", waiting > 0 ? `Inbox ${waiting}` : "Inbox", "Plans that need a decision", () => this.choose(INBOX));
    const tabs = this.tabs.tabs.map((tab) => {
      const kind = [tab.name === this.active ? "on" : "", tab.errors.length > 0 ? "wrong" : ""].filter(Boolean).join(" ");
      return button(kind, words(tab.name), tab.errors[0] ?? tab.help, () => this.choose(tab.name));
    });
    const pose = button(this.active === POSE ? "on" : "", "Pose", "Lead a pose by hand, nudge the robot", () => this.choose(POSE));
    this.nav.replaceChildren(inbox, pose, ...tabs);
  }

  private drawRows(): void {
    const rows = this.rows.map((row) => {
      const standing = standingOfRow(row);
      const item = button(`row ${row.plan_id === this.shown ? "chosen" : ""}`, "", `Open plan ${row.plan_id}`, () => void this.open(row.plan_id));
      item.append(
        el("b", "", [words(row.verdict || row.state), words(row.task ?? "")].filter(Boolean).join(" · ")), el("span", `soft ${standing.tone}`, standing.text),
        el("span", "id", row.plan_id), el("span", "soft", row.created.replace("T", " ").slice(0, 19)),
      );
      return item;
    });
    this.list.replaceChildren(...(rows.length > 0 ? rows : [el("p", "soft", "No plan waits for a decision.")]));
  }

  // Show a task's tab, or what the inbox has open.
  choose(name: string): void {
    this.active = name;
    this.say(this.problem, "");
    this.clear();
    const tab = this.tabs.tabs.find((one) => one.name === name);
    if (tab) {
      this.tab = new TabView(tab, this.tabs, this.link, this.view, (job) => {
        if (job.state === "finished") void this.open(job.plan_id);
      });
      this.scroll.replaceChildren(this.tab.element);
    } else if (name === POSE) {
      this.pose = new PoseTab(this.tabs, this.link, this.robot, this.view, (job) => {
        if (job.state === "finished") void this.open(job.plan_id);
      });
      this.scroll.replaceChildren(this.pose.element);
      if (this.robot.state) this.pose.hearRobot(this.robot.state);
    } else this.scroll.replaceChildren(el("p", "soft", "Choose a plan, or a task above."));
    this.drawTabs();
    this.drawRows();
  }

  private clear(): void {
    this.tab?.close();
    this.tab = null;
    this.pose?.close();
    this.pose = null;
    this.frame = this.beside = null;
    this.view.classList.remove("two");
    this.shown = "";
    this.view.replaceChildren();
  }

  async open(planId: string): Promise<void> {
    try {
      const plan = await this.link.order<Plan>("open", { plan_id: planId });
      this.clear();
      this.shown = planId;
      this.say(this.problem, "");
      this.show(plan);
    } catch (error) {
      this.say(this.problem, saidBy(error));
    }
    void this.refresh();
  }

  private show(plan: Plan): void {
    this.previewed.push(plan.trajectory_sha256);
    const judge = new Judge(plan, (check) => this.look(check), async ({ accept, comment, despite }) => {
      const row = await this.link.order<ReviewedRow>("review", {
        plan_id: plan.plan_id, accept, comment, despite, trajectory_sha256: plan.trajectory_sha256,
        certificate_sha256: plan.certificate_sha256, page_sha256: plan.page_sha256,
      });
      void this.refresh();
      return row;
    }, () => this.link.order<Physics>("simulate", { plan_id: plan.plan_id }), this.compare(plan));
    this.scroll.replaceChildren(judge.element, this.execution(plan, judge));
    if (!plan.has_page) {
      this.view.append(el("p", "broken", "This plan has no page; it was asked for without files."));
      return;
    }
    const shown = this.makeFrame(plan.plan_id);
    this.frame = shown.querySelector("iframe");
    this.view.append(shown);
  }

  // The very page whose hash the approval has; it cannot reach this one. Until it draws, what is awaited is read through it.
  private makeFrame(planId: string): HTMLElement {
    const frame = el("iframe", "viewer");
    frame.setAttribute("sandbox", "allow-scripts allow-downloads");
    frame.title = `Motion of plan ${planId}`;
    frame.src = this.addressOf(planId, "panel=0");
    return el("div", "motion", el("p", "soft", `drawing the motion of plan ${planId.slice(0, 8)}`), frame);
  }

  // Another plan beside the one that is judged: its motion, and its risks against those of this one.
  private compare(plan: Plan): HTMLElement {
    const others = this.rows.filter((row) => row.plan_id !== plan.plan_id && row.verdict !== "");
    const table = el("div", "compared");
    const pick = choice("compare with", [["", "no other plan"], ...others.map((row): [string, string] => [row.plan_id, [words(row.verdict), words(row.task ?? ""), row.created.slice(11, 19)].join(" · ")])], "", (id) => {
      this.beside?.remove();
      this.beside = null;
      this.view.classList.toggle("two", id !== "");
      table.replaceChildren();
      if (id === "") return;
      this.link.order<Plan>("open", { plan_id: id }).then((other) => {
        if (this.shown !== plan.plan_id || pick.value !== id) return;
        if (other.has_page) this.view.append(this.beside = this.makeFrame(id));
        table.replaceChildren(compareRisks(plan, other));
      }, (error: unknown) => table.replaceChildren(el("p", "said bad", saidBy(error))));
    });
    return el("div", "beside", labelled("beside", pick), table);
  }

  // The button that has the robot carry out exactly this motion, once it is accepted and this page has control.
  private execution(plan: Plan, judge: Judge): HTMLElement {
    const placed = el("input");
    const old = el("input");
    placed.type = old.type = "checkbox";
    const opened = Date.now();
    const age = el("span", "", plan.scan_age_s === null ? "" : ` the scan was ${ago(plan.scan_age_s)} old when this plan was opened; I have compared it with what is there just now`);
    let accepted: number | null = null;
    old.addEventListener("change", () => {
      accepted = old.checked ? (plan.scan_age_s ?? 0) + (Date.now() - opened) / 1000 + COMPARED_S : null;
      const ticked = accepted;
      setTimeout(() => { if (accepted === ticked) [old.checked, accepted] = [false, null]; }, 1000 * COMPARED_S);
    });
    // An object is let go only once its own box is ticked: no hand opens by the way.
    const mayOpen = (name: string, text: string): { name: string; box: HTMLInputElement; label: HTMLElement } => {
      const box = el("input");
      box.type = "checkbox";
      box.addEventListener("change", () => refresh());
      return { name, box, label: el("label", "placed lets-go", box, text) };
    };
    const releases = Object.entries(plan.releases).map(([name, phase]) => mayOpen(name, ` the hand may let go of ${name} in ${words(phase)}`));
    // What the robot holds and this plan does not begin with in a hand; a simulated robot that is put at the start holds nothing.
    const others = el("div");
    const forgotten = (): string[] => (placed.checked ? [] : (this.robot.state?.held ?? []).filter((name) => !plan.holds.includes(name)));
    let dropped: typeof releases = [];
    const go = button("yes", "Execute", "Have the robot carry out exactly this motion", () => void this.robot.order("execute", {
      plan_id: plan.plan_id, trajectory_sha256: plan.trajectory_sha256, revision: this.robot.revision, is_placed: placed.checked,
      scan_age_s: accepted, lets_go: [...releases, ...dropped].filter(({ box }) => box.checked).map(({ name }) => name),
    }));
    const why = el("p", "soft");
    const part = section("Robot", why, ...releases.map(({ label }) => label), others, el("label", "placed", placed, " put a simulated robot at the start first"),
      ...(plan.scan_age_s === null ? [] : [el("label", "placed", old, age)]), el("div", "buttons", go));
    const refresh = (): void => {
      part.hidden = !this.robot.state?.is_there;
      if (forgotten().join() !== dropped.map(({ name }) => name).join()) {
        dropped = forgotten().map((name) => mayOpen(name, ` the robot holds ${name}, which this plan does not know; the hand may let go of it`));
        others.replaceChildren(...dropped.map(({ label }) => label));
      }
      const reason = !judge.isAccepted ? "accept the plan first" : !this.robot.state?.has_control ? "take control of the robot first" : !this.robot.mayOrder ? "acknowledge what changed first" : [...releases, ...dropped].some(({ box }) => !box.checked) ? "confirm what the hand lets go first" : "";
      go.disabled = reason !== "";
      why.textContent = reason;
    };
    this.robot.onState = judge.onDecision = refresh;
    placed.addEventListener("change", () => refresh());
    refresh();
    return part;
  }

  private addressOf(planId: string, hash: string): string {
    return `/plans/${encodeURIComponent(planId)}/viewer.html#${hash}&theme=${document.documentElement.dataset.theme}`;
  }

  // The motion goes to where a check is tightest; the number makes the same check twice a change.
  private look(check: number): void {
    if (this.frame) this.frame.src = this.addressOf(this.shown, `panel=0&check=${check}&n=${++this.nth}`);
  }
}

try {
  const settings = JSON.parse(document.getElementById("payload")!.textContent) as Settings;
  const page = new ConsolePage(settings);
  Object.assign(window, { __viewer: {
    ready: true,
    get busy(): boolean { return (page.tab?.view ?? page.pose?.view)?.stage.isBusy ?? false; },
    get state(): State { return page.link.state; },
    get robot(): RobotState | null { return page.robot.state; },
    get hasScan(): boolean { return page.tab?.view !== null && page.tab?.view !== undefined; },
    choose: (name: string): void => page.choose(name),
    open: (id: string): Promise<void> => page.open(id),
    previewed: page.previewed,
    get tab(): TabView | null { return page.tab; },
    get pose(): PoseTab | null { return page.pose; },
    project: (place: number[]): number[] | null => page.tab?.view?.pixel(place) ?? null,
  } });
} catch (error) {
  document.body.append(el("p", "broken", `This page could not be shown: ${String(error)}.`));
  throw error;
}
