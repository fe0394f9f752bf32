// The top bar: verdict, what was planned, its key figures, cameras and theme; and the help overlay.
import { Result } from "./data";
import { button, el, figure, seconds, words } from "./dom";
import { Layer } from "./layer";
import { Told, basisTold, clearanceTold, family, insideTold } from "./standing";
import { VIEWS, View } from "./stage";

const GOOD = "CERTIFIED";
const TONES: Record<string, "good" | "fair"> = { CERTIFIED: "good", DONE: "good", FEASIBLE_AT_SAMPLES: "fair", STOOD: "fair" };
const IN_PHYSICS: Record<string, string> = {
  DONE: "the robot stands and its work is done",
  STOOD: "the robot stands, its work is not done",
  FELL: "the robot fell",
};
const MEANING: Record<string, string> = {
  FEASIBLE_AT_SAMPLES: "holds at dense samples; a proof is missing",
  NOT_FOUND: "no feasible trajectory found; this is the best attempt",
  INFEASIBLE: "no trajectory can exist",
  TIME_LIMIT: "out of time; this is the best attempt so far",
  CANCELLED: "stopped by the user; this is the best attempt so far",
};

export const tone = (verdict: string): "good" | "fair" | "bad" => TONES[verdict] ?? "bad";

// The verdict of the page: that of the simulation where the plan was carried out in physics.
export const headline = (result: Result): string => result.simulated?.verdict ?? result.verdict;

function chip(name: string, value: string, title = ""): HTMLElement {
  const element = el("span", "chip", el("small", "", name), el("b", "", value));
  element.title = title;
  return element;
}

export interface Header { element: HTMLElement; setView(view: View | null): void; setXray(on: boolean): void }

export function makeHeader(
  result: Result, show: (view: View) => void, toggle: { theme(): void; xray(): void; help(): void; panel(): void },
): Header {
  const chips = el("div", "chips");
  const told: [string, Told | undefined][] = [
    ["clearance", clearanceTold(result)], ["balance", insideTold(family(result, "balance"))], ["ZMP", insideTold(family(result, "zmp"))],
  ];
  for (const [name, said] of told) {
    if (!said) continue;
    const element = chip(`${name}, ${said.standing}`, said.value, `${name}: ${said.text}`);
    element.classList.add(said.standing.replaceAll(" ", "-"));
    chips.append(element);
  }
  if (typeof result.figures.turned_deg === "number") chips.append(chip("turned", figure(result.figures.turned_deg, "deg")));
  if (typeof result.planning_time_s === "number") {
    const planned = chip("planned in", seconds(result.planning_time_s));
    planned.classList.add("planned");
    chips.append(planned);
  }

  const names: Record<View, string> = { "3d": "3D", front: "Front", side: "Side", top: "Top", hand: "Hand" };
  const views = new Map(VIEWS.map((view, i) => [view, button("", names[view], `${names[view]} view (${i + 1})`, () => show(view))]));
  const xray = button("", "X-ray", "See through the robot (x)", toggle.xray);
  const tools = el(
    "div", "tools", el("div", "segmented", ...views.values()), xray,
    button("round", "◐", "Dark or light (d)", toggle.theme), button("round", "?", "Keys (?)", toggle.help),
    button("round", "☰", "Panel (i)", toggle.panel),
  );
  const meaning = result.verdict === GOOD ? basisTold(result) : MEANING[result.verdict] ?? "";
  // A plan without a motion has a reason instead: that comes first.
  const [reason] = result.explanation;
  const planned = result.times.length > 1 ? meaning : reason ?? meaning.split("; this is")[0];
  const carried = result.simulated;
  const said = carried ? `in physics, ${carried.reasons[0] ?? IN_PHYSICS[carried.verdict]}; the plan is ${words(result.verdict)}` : planned;
  const verdict = el("div", `verdict ${tone(headline(result))}`, words(headline(result) || "NO VERDICT"));
  verdict.title = said;
  const title = [result.robot, result.task].filter(Boolean).map(words).join(" · ");
  const says = el("span", "says", said);
  const element = el("header", "top", verdict, el("div", "what", el("h1", "", title || "scene"), says), chips, tools);
  return {
    element,
    setView: (view) => views.forEach((item, name) => item.classList.toggle("on", name === view)),
    setXray: (on) => xray.classList.toggle("on", on),
  };
}

export function makeHelp(layers: Layer[]): HTMLElement {
  const keys: [string, string][] = [
    ["space", "play or pause"], ["← →", "previous, next waypoint"], [", .", "previous, next frame"],
    ["[ ]", "previous, next phase"], ["Home End", "start, end"], ["+ −", "faster, slower"], ["1 … 5", "3D, front, side, top, hand"],
    ["n", "next check"], ["x", "x-ray"], ["h", "follow the hand"], ["d", "dark or light"], ["l", "labels"], ["s", "save a picture"],
    ["i", "panel"], ["Esc", "close, deselect"], ...layers.map((layer): [string, string] => [layer.key, layer.label.toLowerCase()]),
  ];
  const list = el("div", "keys", ...keys.flatMap(([key, what]) => [el("kbd", "", key), el("span", "", what)]));
  const mouse = el("p", "", "Drag turns, right drag shifts, wheel zooms, double click looks at a place, hovering names it.");
  const help = el("div", "help", el("div", "card", el("h2", "", "Keys"), list, mouse));
  help.hidden = true;
  help.addEventListener("click", () => { help.hidden = true; });
  return help;
}
