// One plan as the operator judges it: risk first, what is assumed, checks by phase, and the decision.
import { Physics, Plan, ReviewedRow, standingOfRow } from "./console-data";
import { button, el, figure, seconds, title, words } from "./dom";
import { tone } from "./header";

const MARKS = { proven: "✓", "at samples": "✓", unproven: "?", refuted: "✕" };
const KINDS = { proven: "ok", "at samples": "ok", unproven: "unsure", refuted: "fail" };
const GOOD = "CERTIFIED";
const PHYSICS: Record<string, string> = { DONE: "good", STOOD: "fair", FELL: "bad" };

export interface Decision { accept: boolean; comment: string; despite: string }

export function section(name: string, ...content: (Node | string)[]): HTMLElement {
  return el("section", "", el("h2", "", name), ...content);
}

export class Judge {
  readonly element = el("div", "judge");
  isAccepted = false;
  onDecision: () => void = () => {};
  private readonly said = el("p", "said");
  private readonly comment = el("textarea", "comment");
  private readonly despite = el("input", "despite");

  constructor(
    private readonly plan: Plan, private readonly look: (check: number) => void, decide: (decision: Decision) => Promise<ReviewedRow>,
    simulate: () => Promise<Physics>, beside: HTMLElement,
  ) {
    const { verdict } = plan;
    const badge = el("div", `verdict ${tone(verdict)}`, words(verdict));
    const lasts = plan.duration_s === null ? "no motion" : `lasts ${seconds(plan.duration_s)}`;
    this.element.append(el("div", "sum", badge, this.physics(simulate), el("span", "soft", `${lasts} · planned in ${seconds(plan.planning_time_s)}`)), beside);
    if (plan.explanation.length > 0) {
      this.element.append(section("What stands in the way", el("ul", "why", ...plan.explanation.map((line) => el("li", "", line)))));
    }
    if (plan.risks.length > 0) this.element.append(section("Risk", el("div", "risks", ...plan.risks.map((risk) => this.risk(risk.check, risk.title, risk)))));
    const assumed = [...plan.not_checked.map((line) => `not checked: ${line}`), ...plan.assumed];
    if (assumed.length > 0) this.element.append(section("Assumed, and not checked", el("ul", "notes", ...assumed.map((line) => el("li", "", line)))));
    if (plan.checks.length > 0) this.element.append(this.checks());
    this.element.append(this.decision(decide));
  }

  // The verdict of physics beside that of the certificate; asked for by a button, since it takes as long as the motion.
  private physics(simulate: () => Promise<Physics>): HTMLElement {
    const place = el("span", "physics");
    const ask = button("no", "Physics", "Carry the motion out in a physics engine", () => {
      ask.disabled = true;
      ask.textContent = "in physics …";
      simulate().then(({ verdict, explanation }) => {
        const badge = el("div", `verdict ${PHYSICS[verdict] ?? "bad"}`, `physics: ${verdict}`);
        badge.title = explanation.join("; ");
        place.replaceChildren(badge);
      }, (error: unknown) => place.replaceChildren(el("span", "soft bad", error instanceof Error ? error.message : String(error))));
    });
    if (this.plan.duration_s !== null && this.plan.has_page) place.append(ask);
    return place;
  }

  private risk(index: number, name: string, { value, unit, standing, text, count }: Plan["risks"][number]): HTMLElement {
    const row = button(`risk ${KINDS[standing]}`, "", `Show where: ${name}`, () => this.look(index));
    row.append(
      el("span", "name", name), el("span", "value", value === null ? "–" : figure(value, unit)),
      el("span", "detail", text), el("span", "limit", count > 1 ? `${standing}, worst of ${count}` : standing),
    );
    return row;
  }

  private check(index: number): HTMLElement {
    const check = this.plan.checks[index];
    const row = button(`check ${KINDS[check.standing]}`, "", `Show where: ${check.name}`, () => this.look(index));
    row.append(
      el("span", "mark", MARKS[check.standing]), el("span", "name", title(check.name)),
      el("span", "value", check.value === null ? "" : figure(check.value, check.unit)),
      el("span", "detail", check.text ?? ""), el("span", "limit", check.limit === null ? "" : `limit ${figure(check.limit, check.unit)}`),
    );
    return row;
  }

  // What is open stands there; what holds is folded, phase by phase.
  private checks(): HTMLElement {
    const open = this.plan.groups.reduce((sum, group) => sum + group.open.length, 0);
    const all = this.plan.checks.length;
    const groups = this.plan.groups.map((group) => {
      const folded = el("details", "group", el("summary", "", el("b", "", words(group.phase)), ` · ${group.passed.length} hold`));
      if (group.open.length > 0) folded.open = false;
      folded.append(el("div", "checks", ...group.passed.map((index) => this.check(index))));
      const standing = el("div", "checks", ...group.open.map((index) => this.check(index)));
      return el("div", "ofphase", ...(group.open.length > 0 ? [el("h3", "", words(group.phase)), standing] : []), ...(group.passed.length > 0 ? [folded] : []));
    });
    return section(open === 0 ? `Checks · all ${all} hold` : `Checks · ${open} of ${all} do not hold`, ...groups);
  }

  private decision(decide: (decision: Decision) => Promise<ReviewedRow>): HTMLElement {
    const { verdict } = this.plan;
    this.comment.placeholder = "Comment";
    this.comment.rows = 2;
    this.despite.placeholder = `Type ${verdict} to accept it all the same`;
    const act = async (accept: boolean): Promise<void> => {
      for (const one of [yes, no]) one.disabled = true;
      try {
        const row = await decide({ accept, comment: this.comment.value, despite: accept && verdict !== GOOD ? this.despite.value.trim() : "" });
        this.tell(row);
      } catch (error) {
        this.say(error instanceof Error ? error.message : String(error), "bad");
      }
      no.disabled = false;
      refresh();
    };
    const yes = button("yes", "Accept", "Accept exactly this motion, certificate and page", () => void act(true));
    const no = button("no", "Reject", "Reject this plan", () => void act(false));
    const refresh = (): void => { yes.disabled = verdict !== GOOD && this.despite.value.trim() !== verdict; };
    this.despite.addEventListener("input", refresh);
    refresh();
    this.tell(this.plan);
    return section("Decision", this.said, this.comment, ...(verdict === GOOD ? [] : [this.despite]), el("div", "buttons", yes, no));
  }

  private tell(row: ReviewedRow): void {
    this.isAccepted = row.is_approved || (row.reviews.at(-1)?.is_accepted ?? false);
    this.onDecision();
    const last = row.reviews.at(-1);
    const standing = row.needs_decision && last ? { text: "acceptance expired", tone: "fair" } : standingOfRow(row);
    const by = last ? ` by ${last.reviewer}${last.comment ? `: ${last.comment}` : ""}` : "";
    this.say(`${standing.text}${by}`, standing.tone);
  }

  private say(text: string, kind: string): void {
    this.said.textContent = text;
    this.said.className = `said ${kind}`;
  }
}

// Verdict, duration and risks of two plans in two columns, the judged one first.
export function compareRisks(own: Plan, other: Plan): HTMLElement {
  const cell = (plan: Plan, name: string): string => {
    const risk = plan.risks.find((one) => one.title === name);
    return !risk || risk.value === null ? "–" : `${figure(risk.value, risk.unit)} ${MARKS[risk.standing]}`;
  };
  const lasts = (plan: Plan): string => (plan.duration_s === null ? "–" : seconds(plan.duration_s));
  const names = [...new Set([...own.risks, ...other.risks].map((risk) => risk.title))];
  const rows = [
    ["", "this plan", "the other"], ["verdict", words(own.verdict), words(other.verdict)], ["lasts", lasts(own), lasts(other)],
    ...names.map((name) => [name, cell(own, name), cell(other, name)]),
  ];
  return el("table", "compared", ...rows.map((row) => el("tr", "", ...row.map((text) => el("td", "", text)))));
}
