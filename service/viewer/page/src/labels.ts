// Text that stands at places of the scene, drawn as HTML over the canvas so that it stays sharp.
import { PerspectiveCamera, Vector3 } from "three";

export interface Label { at: Vector3; text: string; kind: "target" | "good" | "fair" | "bad" | "spot" | "force"; isOn: boolean; isDim?: boolean; isBelow?: boolean }

interface Shown { label: Label; element: HTMLElement; text: HTMLElement; width: number }
interface Box { left: number; right: number; top: number; bottom: number }

// Who keeps its place when two labels meet.
const RANK: Record<Label["kind"], number> = { bad: 0, fair: 1, good: 1, force: 2, target: 2, spot: 3 };
const HEIGHT = 24;
const LIFT: Record<Label["kind"], number> = { bad: 22, fair: 22, good: 22, target: 12, force: 10, spot: -34 };
const BELOW = -34;

export class Labels {
  private readonly shown: Shown[] = [];

  constructor(private readonly host: HTMLElement) {}

  add(label: Label): void {
    const text = document.createElement("span");
    const element = document.createElement("div");
    element.className = `label ${label.kind}`;
    element.append(text);
    this.host.append(element);
    this.shown.push({ label, element, text, width: 0 });
    this.shown.sort((a, b) => RANK[a.label.kind] - RANK[b.label.kind]);
  }

  place(camera: PerspectiveCamera, width: number, height: number): void {
    const taken: Box[] = [];
    const p = new Vector3();
    for (const entry of this.shown) {
      const { label, element, text } = entry;
      p.copy(label.at).project(camera);
      const isSeen = label.isOn && p.z < 1 && Math.abs(p.x) < 1.02 && Math.abs(p.y) < 1.02;
      element.hidden = !isSeen;
      element.classList.toggle("dim", label.isDim === true);
      if (!isSeen) continue;
      if (text.textContent !== label.text || entry.width === 0) {
        text.textContent = label.text;
        entry.width = text.offsetWidth;
      }
      const x = ((p.x + 1) * width) / 2;
      const y = ((1 - p.y) * height) / 2;
      // Slides along the edge instead of leaving the picture, and past labels that are there already: upwards, or downwards what hangs below its place.
      const shift = Math.min(Math.max(x, entry.width / 2 + 4), width - entry.width / 2 - 4) - x;
      const left = x + shift - entry.width / 2;
      const lift = label.isBelow ? BELOW : LIFT[label.kind];
      const box: Box = { left, right: left + entry.width, top: y - lift - HEIGHT, bottom: y - lift };
      for (let tries = 0; tries < 8; tries++) {
        const other = taken.find((b) => b.left < box.right && b.right > box.left && b.top < box.bottom && b.bottom > box.top);
        if (!other) break;
        box.bottom = lift < 0 ? other.bottom + 3 + HEIGHT : other.top - 3;
        box.top = box.bottom - HEIGHT;
      }
      taken.push(box);
      element.style.transform = `translate(${x}px, ${y}px)`;
      text.style.transform = `translate(${shift - entry.width / 2}px, ${box.bottom - y}px)`;
    }
  }
}
