// Text that stands at places of the scene, drawn as HTML over the canvas so that it stays sharp.
import { PerspectiveCamera, Vector3 } from "three";

export interface Label { at: Vector3; text: string; kind: "target" | "good" | "bad" | "spot"; isOn: boolean }

export class Labels {
  private readonly shown: { label: Label; element: HTMLElement; span: HTMLElement }[] = [];

  constructor(private readonly host: HTMLElement) {}

  add(label: Label): void {
    const element = document.createElement("div");
    element.className = `label ${label.kind}`;
    const text = document.createElement("span");
    text.textContent = label.text;
    element.append(text);
    this.host.append(element);
    this.shown.push({ label, element, span: text });
  }

  place(camera: PerspectiveCamera, width: number, height: number): void {
    const p = new Vector3();
    for (const { label, element, span } of this.shown) {
      if (span.textContent !== label.text) span.textContent = label.text;
      p.copy(label.at).project(camera);
      const isSeen = label.isOn && p.z < 1 && Math.abs(p.x) < 1.05 && Math.abs(p.y) < 1.05;
      element.hidden = !isSeen;
      if (isSeen) element.style.transform = `translate(${((p.x + 1) * width) / 2}px, ${((1 - p.y) * height) / 2}px)`;
    }
  }
}
