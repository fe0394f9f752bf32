// One task tab, made of its task file: scan, a click on an object, parameters, and the plan.
import {
  Found, FoundHit, Job, OLD_SCAN_S, Parameter, RUNNING, ScanChanges, ScanCloud, ScanRow, Tab, Tabs, Unseen, ago, askedFor, readValue, writeValue,
} from "./console-data";
import { choice, labelled, recall, remember } from "./console-fields";
import { section } from "./console-judge";
import { Link, points } from "./console-link";
import { ScanView } from "./console-scan";
import { button, el, words } from "./dom";

const NONE = "";

export class TabView {
  readonly element = el("div", "tab");
  view: ScanView | null = null;
  private readonly fields = new Map<string, { parameter: Parameter; input: HTMLInputElement | HTMLSelectElement }>();
  private readonly said = el("p", "said");
  private readonly found = el("div", "found");
  private readonly newer = el("div", "chips newer");
  private readonly moved = el("p", "soft moved");
  private readonly shading = el("input");
  private readonly moving = el("div", "moving");
  private scanChoice: HTMLSelectElement | null = null;
  private readonly progress = el("div", "progress");
  private readonly plan: HTMLButtonElement;
  private readonly robot: HTMLSelectElement;
  private readonly posture = el("select", "choice");
  private scan: string;
  private hits: FoundHit[] = [];
  private chosen = -1;
  private job: Job | null = null;
  private asked = 0;

  constructor(
    readonly tab: Tab, private readonly tabs: Tabs, private readonly link: Link, private readonly host: HTMLElement,
    private readonly onJob: (job: Job) => void,
  ) {
    this.element.append(el("p", "about", tab.help));
    this.plan = button("yes", "Plan", "Plan this task", () => void this.ask());
    const robots = tabs.robots.map(({ name }): [string, string] => [name, name]);
    const remembered = recall("robot");
    const first = tabs.robots.some(({ name }) => name === remembered) ? remembered! : tabs.robots.some(({ name }) => name === "atlas") ? "atlas" : robots[0]?.[0] ?? "";
    this.robot = choice("robot", robots, first, (name) => { remember("robot", name); this.listPostures(); void this.showScan(); });
    this.posture.setAttribute("aria-label", "posture");
    this.posture.addEventListener("change", () => { remember(`posture-${this.robot.value}`, this.posture.value); void this.showScan(); });
    this.listPostures();
    // Of a task that looks for nothing, a scan is what may be in the way.
    const known = recall("scan");
    this.scan = tabs.scans.some(({ name }) => name === known) ? known! : tabs.scans[0]?.name ?? NONE;
    if (tab.errors.length > 0) {
      this.element.append(section("This task file cannot be used", el("ul", "why", ...tab.errors.map((line) => el("li", "", line)))));
      return;
    }
    this.build();
    void this.showScan();
  }

  private build(): void {
    const { tab, tabs } = this;
    const scans: [string, string][] = [...tabs.scans.map(({ name, age_s }): [string, string] => [name, `${name} · ${ago(age_s)} old`]), [NONE, "no scan"]];
    const scan = choice("scan", scans, this.scan, (name) => {
      this.scan = name;
      if (name !== NONE) remember("scan", name);
      void this.showScan();
    });
    this.scanChoice = scan;
    this.shading.type = "checkbox";
    this.shading.checked = recall("unseen") === "yes";
    this.shading.addEventListener("change", () => { remember("unseen", this.shading.checked ? "yes" : "no"); void this.shade(); });
    this.element.append(section("Scan", scan, this.newer, this.moved, el("label", "placed", this.shading, " shade what the scan has not seen")));
    if (tab.kinds.length > 0) this.element.append(section(tab.kinds.map(words).join(" or "), this.found, this.moving));
    const fields = askedFor(tab).map((parameter) => this.field(parameter));
    const given = tab.parameters.filter(({ detect }) => detect !== null).map((parameter) => this.field(parameter));
    if (fields.length > 0) this.element.append(section("Parameters", ...fields));
    if (given.length > 0) {
      this.element.append(el("details", "group", el("summary", "", "Given by the object"), ...given));
    }
    this.element.append(
      section("Robot at the start", labelled("robot", this.robot), labelled("posture", this.posture)), this.said, el("div", "buttons", this.plan), this.progress,
    );
  }

  // The scans that there are now; a newer one than that which is shown is offered.
  hearScans(scans: ScanRow[]): void {
    const [newest] = scans;
    const shown = scans.find(({ name }) => name === this.scan);
    if (!this.scanChoice || !newest || !shown || newest.name === this.scan) return this.newer.replaceChildren();
    if (this.newer.dataset.name === newest.name && this.newer.childElementCount > 0) return;
    this.newer.dataset.name = newest.name;
    this.newer.replaceChildren(button("", `Update with ${newest.name}`, `${newest.name} is ${ago(newest.age_s)} old, newer than ${this.scan}`, () => void this.update(newest)));
  }

  // Take a newer scan in place of the one that is shown, and show what moved.
  private async update(newest: ScanRow): Promise<void> {
    const before = this.scan;
    if (![...this.scanChoice!.options].some(({ value }) => value === newest.name)) {
      const option = el("option", "", `${newest.name} · ${ago(newest.age_s)} old`);
      option.value = newest.name;
      this.scanChoice!.prepend(option);
    }
    this.scanChoice!.value = this.scan = newest.name;
    remember("scan", this.scan);
    this.newer.replaceChildren();
    await this.showScan();
    const { view } = this;
    if (!view) return;
    this.moved.textContent = "looking for what moved";
    try {
      const changes = await this.link.order<ScanChanges>("changes", { ...this.stood(), before });
      if (view !== this.view) return;
      view.showChanges(changes);
      this.moved.textContent = `since ${before}: ${changes.line}`;
    } catch (error) {
      if (view === this.view) this.moved.textContent = String(error instanceof Error ? error.message : error);
    }
  }

  private listPostures(): void {
    const postures = this.tabs.robots.find(({ name }) => name === this.robot.value)?.postures ?? [];
    this.posture.replaceChildren(...[NONE, ...postures].map((name) => {
      const option = el("option", "", name === NONE ? "its own" : words(name));
      option.value = name;
      return option;
    }));
    const known = recall(`posture-${this.robot.value}`);
    // Hands in front of the body: what most tasks begin with.
    this.posture.value = known !== null && (known === NONE || postures.includes(known)) ? known : postures.find((name) => name.includes("ready")) ?? NONE;
  }

  private field(parameter: Parameter): HTMLElement {
    const written = writeValue(parameter.default);
    const input = parameter.type === "choice" ? choice(parameter.name, parameter.choices.map((value) => [value, value]), written, () => {}) : el("input", "text");
    if (input instanceof HTMLInputElement) input.value = parameter.detect === null ? written : "";
    if (input instanceof HTMLInputElement && parameter.detect !== null) input.placeholder = `of the ${words(parameter.detect)}`;
    this.fields.set(parameter.name, { parameter, input });
    const name = `${words(parameter.name)}${parameter.unit ? ` [${parameter.unit}]` : ""}`;
    const field = labelled(name, input);
    field.title = parameter.help;
    return field;
  }

  private async showScan(): Promise<void> {
    this.view?.close();
    this.view = null;
    this.hits = [];
    this.chosen = -1;
    this.moved.textContent = "";
    this.listHits();
    if (this.scan === NONE) return this.say(this.tab.kinds.length > 0 ? "there is no scan; put a cloud file into the folder of --scans" : "", "fair");
    const asked = ++this.asked;
    this.say("reading the scan", "");
    try {
      const scan = await this.link.order<ScanCloud>("scan", { ...this.stood(), ...points() });
      if (asked !== this.asked || !this.element.isConnected) return;
      this.view = new ScanView(scan.cloud, this.host);
      this.view.onClick = (at) => void this.detect(at);
      this.view.onMove = (by) => {
        const hit = this.hits.find((one) => one.hit === this.chosen);
        if (hit) void this.move(hit, hit.moved_m.map((value, axis) => value + by[axis]));
      };
      if (this.shading.checked) void this.shade();
      const what = this.tab.kinds.length > 0 ? `click on the ${words(this.tab.kinds[0])}` : "";
      if (scan.age_s > OLD_SCAN_S) this.say(`this scan is ${ago(scan.age_s)} old${what ? `; ${what}` : ""}`, "fair");
      else this.say(what, "");
    } catch (error) {
      if (asked === this.asked) this.say(String(error instanceof Error ? error.message : error), "bad");
    }
  }

  private async shade(): Promise<void> {
    const { view } = this;
    if (!view || !this.shading.checked) return view?.shade(null);
    try {
      const { cells } = await this.link.order<Unseen>("unseen", this.stood());
      if (view === this.view && this.shading.checked) view.shade(cells);
    } catch (error) {
      this.say(String(error instanceof Error ? error.message : error), "bad");
    }
  }

  // The scan, and the robot that stood in it.
  private stood(): Record<string, unknown> {
    return { scan: this.scan, robot: this.robot.value, posture: this.posture.value || null };
  }

  private async detect(at: number[]): Promise<void> {
    if (this.tab.kinds.length === 0) return;
    const asked = ++this.asked;
    this.say("looking there", "");
    try {
      const found = await this.link.order<Found>("detect", { ...this.stood(), at, kinds: this.tab.kinds });
      if (asked !== this.asked) return;
      this.hits = found.hits;
      this.choose(found.hits[0]?.hit ?? -1);
      this.say(found.hits.length === 0 ? ["nothing of this kind was found there", ...found.notes].join("; ") : "", "bad");
    } catch (error) {
      if (asked === this.asked) this.say(String(error instanceof Error ? error.message : error), "bad");
    }
  }

  private choose(hit: number): void {
    this.chosen = hit;
    this.listHits();
    this.view?.showHits(this.hits, hit);
  }

  private listHits(): void {
    this.found.replaceChildren(...this.hits.map((hit) => {
      const isSure = hit.confidence >= 0.5;
      const row = button(`check ${isSure ? "ok" : "unsure"}${hit.hit === this.chosen ? " chosen" : ""}`, "", "Take this fit", () => this.choose(hit.hit));
      const place = hit.pose_world_object.slice(0, 3).map((line) => line[3].toFixed(2)).join(", ");
      row.append(
        el("span", "mark", isSure ? "✓" : "?"), el("span", "name", words(hit.kind)), el("span", "value", `${Math.round(100 * hit.confidence)} %`),
        el("span", "detail", [`at ${place} m`, ...(hit.moved_m.some(Boolean) ? ["moved by hand"] : []), ...hit.doubts].join("; ")),
      );
      return row;
    }));
    if (this.hits.length === 0) this.found.append(el("p", "soft", "none chosen"));
    this.listMoves();
  }

  // How far the chosen fit was moved from where the scan shows it; by numbers here, by its arrows in the view.
  private listMoves(): void {
    const hit = this.hits.find((one) => one.hit === this.chosen);
    if (!hit) return this.moving.replaceChildren();
    const input = el("input", "text");
    input.value = hit.moved_m.map((value) => value.toFixed(3)).join(", ");
    input.addEventListener("change", () => {
      const moved = input.value.split(/[\s,;]+/).filter(Boolean).map(Number);
      if (moved.length === 3 && moved.every(Number.isFinite)) void this.move(hit, moved);
      else this.say(`moved: expected 3 numbers, got "${input.value}"`, "bad");
    });
    const field = labelled("moved by [m]", input);
    field.title = "from where the scan shows it, in world axes; or drag the arrows in the view";
    this.moving.replaceChildren(field);
  }

  private async move(hit: FoundHit, moved: number[]): Promise<void> {
    try {
      const made = await this.link.order<FoundHit>("move_hit", { hit: hit.hit, moved_m: moved });
      this.hits = this.hits.map((one) => (one.hit === hit.hit ? made : one));
      this.choose(made.hit);
      this.say("", "");
    } catch (error) {
      this.choose(this.chosen);
      this.say(String(error instanceof Error ? error.message : error), "bad");
    }
  }

  private async ask(): Promise<void> {
    const values: Record<string, unknown> = {};
    for (const { parameter, input } of this.fields.values()) {
      const { value, problem } = readValue(parameter, input.value);
      if (problem !== undefined) return this.say(problem, "bad");
      if (value !== undefined) values[parameter.name] = value;
    }
    this.plan.disabled = true;
    this.say("", "");
    try {
      const job = await this.link.order<Job>("plan", {
        ...this.stood(), task: this.tab.name, values, scan: this.scan || null,
        hit: this.chosen < 0 ? null : this.chosen,
      });
      // What became of it may have been told before the answer came.
      if (this.job?.job !== job.job) this.take(job);
    } catch (error) {
      this.say(String(error instanceof Error ? error.message : error), "bad");
      this.plan.disabled = false;
    }
  }

  // What becomes of the plan that this tab asked for.
  follow(job: Job): void {
    if (job.task !== this.tab.name || (this.job && job.job < this.job.job)) return;
    if (!this.job && !RUNNING.includes(job.state) && !this.plan.disabled) return;
    this.take(job);
  }

  private take(job: Job): void {
    this.job = job;
    const isRunning = RUNNING.includes(job.state);
    this.plan.disabled = isRunning;
    const bar = el("i");
    bar.style.width = `${Math.round(100 * job.fraction)}%`;
    const stop = button("no", "Stop", "Stop this plan", () => void this.link.order("cancel", { job: job.job }).catch(() => {}));
    this.progress.replaceChildren(...(isRunning ? [el("div", "bar", bar), el("span", "soft", [job.state, job.step].filter(Boolean).join(" · ")), stop] : []));
    if (job.state === "failed" || job.state === "stopped") this.say(job.error || "the plan was stopped", "bad");
    this.onJob(job);
  }

  private say(text: string, kind: string): void {
    this.said.textContent = text;
    this.said.className = `said ${text ? kind : ""}`;
  }

  close(): void {
    this.asked += 1;
    this.view?.close();
    this.view = null;
  }
}
