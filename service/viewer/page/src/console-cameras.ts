// Pictures of cameras beside the view: the one of the running phase, with what the plan leads drawn over it.
import { CameraChoice, CameraPicture } from "./console-data";
import { choice } from "./console-fields";
import { IS_SLOW, Link } from "./console-link";
import { el, svg, words } from "./dom";

const PERIOD_MS = IS_SLOW ? 30_000 : 700;
const AUTO = "";

export class CameraPanel {
  readonly element = el("div", "cameras");
  private readonly image = el("img");
  private readonly marks = svg("svg", { viewBox: "0 0 100 75", preserveAspectRatio: "none" });
  private readonly said = el("span", "soft");
  private readonly pick = el("span");
  private cameras: CameraChoice[] = [];
  private chosen = AUTO;
  private phase = "";
  private isAwaited = false;

  constructor(private readonly link: Link) {
    this.image.alt = "picture of a camera of the robot";
    this.element.append(el("div", "bar-camera", this.pick, this.said), el("div", "shot", this.image, this.marks as unknown as HTMLElement));
    this.element.hidden = true;
    setInterval(() => { if (!document.hidden) void this.refresh(); }, PERIOD_MS);
  }

  list(cameras: CameraChoice[]): void {
    if (JSON.stringify(cameras) === JSON.stringify(this.cameras)) return;
    this.cameras = cameras;
    this.element.hidden = cameras.length === 0;
    const names = cameras.map(({ name }): [string, string] => [name, words(name)]);
    this.pick.replaceChildren(choice("camera", [[AUTO, "camera by phase"], ...names], this.chosen, (name) => { this.chosen = name; void this.refresh(); }));
  }

  show(phase: string): void { this.phase = phase; }

  // The camera that was chosen, that whose words the phase has, or one for all phases.
  get camera(): string {
    const phase = this.phase.toLowerCase();
    const byPhase = this.cameras.find(({ phases }) => phases.some((word) => phase.includes(word.toLowerCase())));
    return this.chosen || (byPhase ?? this.cameras.find(({ phases }) => phases.length === 0) ?? this.cameras[0])?.name || "";
  }

  private async refresh(): Promise<void> {
    const { camera } = this;
    if (camera === "" || this.isAwaited || this.link.state !== "open") return;
    this.isAwaited = true;
    try {
      const picture = await this.link.order<CameraPicture>("picture", { camera });
      this.image.src = picture.image;
      this.draw(picture.marks);
      this.said.textContent = `${words(camera)}${this.phase ? ` · ${words(this.phase)}` : ""}`;
      this.element.classList.add("has-picture");
    } catch (error) {
      this.element.classList.remove("has-picture");
      this.said.textContent = error instanceof Error ? error.message : String(error);
    } finally {
      this.isAwaited = false;
    }
  }

  private draw(marks: Record<string, number[]>): void {
    this.marks.replaceChildren(...Object.entries(marks).flatMap(([name, [u, v]]) => {
      const at = { x: String(100 * u + 2.5), y: String(75 * v + 1), class: "mark-name" };
      const text = svg("text", at);
      text.textContent = words(name);
      return [svg("circle", { cx: String(100 * u), cy: String(75 * v), r: "1.8" }), text];
    }));
  }
}
