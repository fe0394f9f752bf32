// The scan of a task tab: its points, a click on one of them, and the objects that were found there.
import { Box3, Object3D, Points, ShaderMaterial, Vector3 } from "three";
import { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
import { FoundHit, ScanChanges, pick, tintByHeight } from "./console-data";
import { el } from "./dom";
import { Labels } from "./labels";
import { Quantized, points as unpack } from "./packed";
import { Hits, Origin, pointCloud } from "./scene-layers";
import { Stage } from "./stage";
import { THEMES } from "./theme";

const FEW = 0.1;   // of the points, that may lie outside of what is looked at
const UNSEEN = [0.55, 0.2, 0.75];
const STILL = 4;   // [px] that a click may move

export class ScanView {
  readonly element = el("div", "scanview");
  onClick: (at: number[]) => void = () => {};
  onMove: (by: number[]) => void = () => {};  // the chosen fit was dragged by so much, and let go [m]
  readonly stage: Stage;
  private readonly points: Float32Array;
  private readonly overlay = el("div", "labels");
  private labels: Labels;
  private hits: Hits | null = null;
  private shaded: Points | null = null;
  private readonly origin = new Origin();
  private readonly theme: "dark" | "light";
  private readonly subject: Box3;
  private readonly gizmo: TransformControls;
  private readonly proxy = new Object3D();  // where the gizmo has the chosen fit
  private grabbed: Vector3 | null = null;   // where it was when the drag began

  constructor(cloud: Quantized, host: HTMLElement) {
    this.points = unpack(cloud);
    host.append(this.element);
    this.element.append(this.overlay);
    this.labels = new Labels(this.overlay);
    this.subject = middleOf(this.points);
    this.theme = document.documentElement.dataset.theme === "light" ? "light" : "dark";
    this.stage = new Stage(this.element, { box: this.subject, heading: new Vector3(1, 0, 0), side: 1, hand: () => undefined });
    this.stage.scene.add(pointCloud(this.points, tintByHeight(this.points), 9, 1), this.origin.group);
    this.gizmo = new TransformControls(this.stage.camera, this.stage.renderer.domElement);
    this.gizmo.setSize(0.6);
    this.gizmo.addEventListener("change", () => this.stage.draw());
    this.gizmo.addEventListener("dragging-changed", ({ value }) => this.grab(value === true));
    this.gizmo.addEventListener("objectChange", () => this.hits?.group.position.copy(this.proxy.position).sub(this.grabbed ?? this.proxy.position));
    this.stage.scene.add(this.proxy, this.gizmo.getHelper());
    this.origin.recolour();
    this.stage.recolour(THEMES[this.theme]);
    this.stage.onFrame = () => this.labels.place(this.stage.camera, ...this.stage.size);
    this.stage.resize();
    this.look(this.subject, new Vector3(-1, 0.4, 0.3).normalize(), true);
    this.listen();
  }

  private grab(on: boolean): void {
    this.stage.controls.enabled = !on;
    const from = this.grabbed;
    this.grabbed = on ? this.proxy.position.clone() : null;
    if (!on && from) this.onMove(this.proxy.position.clone().sub(from).toArray());
  }

  private listen(): void {
    const canvas = this.stage.renderer.domElement;
    let pressed = [0, 0];
    canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
    canvas.addEventListener("click", (event) => {
      if (Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) >= STILL || this.gizmo.axis !== null) return;
      const { ray } = this.stage.ray(event.clientX, event.clientY);
      const index = pick(this.points, ray.origin.toArray(), ray.direction.toArray());
      if (index >= 0) this.onClick([0, 1, 2].map((axis) => this.points[3 * index + axis]));
    });
  }

  private look(box: Box3, direction: Vector3, isSudden: boolean): void {
    const centre = box.getCenter(new Vector3());
    this.stage.moveTo(centre.clone().addScaledVector(direction, this.stage.fitting(direction, box)), centre, isSudden);
  }

  // Draw the objects over the points, so that a wrong part is seen; the chosen one alone once there is one.
  showHits(found: FoundHit[], chosen: number): void {
    if (this.hits) this.stage.scene.remove(this.hits.group);
    this.overlay.replaceChildren();
    this.labels = new Labels(this.overlay);
    const shown = chosen < 0 ? found : found.filter((hit) => hit.hit === chosen);
    this.hits = new Hits({ detections: shown.map((hit) => ({ ...hit, points: unpack(hit.points) })) });
    this.hits.recolour(THEMES[this.theme]);
    this.stage.scene.add(this.hits.group);
    for (const label of this.hits.labels) this.labels.add(label);
    const held = found.find((hit) => hit.hit === chosen);
    if (held) this.gizmo.attach(this.proxy);
    else this.gizmo.detach();
    this.proxy.position.fromArray(held ? held.pose_world_object.slice(0, 3).map((line) => line[3]) : [0, 0, 0]);
    this.stage.draw();
  }

  // What moved since an earlier scan: new points bright green, those that are gone red.
  showChanges(changes: ScanChanges): void {
    for (const [packed, tint] of [[changes.added, [0.1, 0.95, 0.3]], [changes.gone, [0.95, 0.15, 0.15]]] as [Quantized, number[]][]) {
      const places = unpack(packed);
      if (places.length === 0) continue;
      this.stage.scene.add(pointCloud(places, Float32Array.from(places, (_, i) => tint[i % 3]), 18, 1));
    }
    this.stage.draw();
  }

  // Shade where seen space ends without a surface; null takes the shade away.
  shade(cells: Quantized | null): void {
    if (this.shaded) this.stage.scene.remove(this.shaded);
    this.shaded = null;
    if (cells) {
      const places = unpack(cells);
      this.shaded = pointCloud(places, Float32Array.from(places, (_, i) => UNSEEN[i % 3]), 46, 0.1);
      this.shaded.renderOrder = 2;
      (this.shaded.material as ShaderMaterial).depthWrite = false;
      this.stage.scene.add(this.shaded);
    }
    this.stage.draw();
  }

  get isShaded(): boolean { return this.shaded !== null; }

  // Page pixel of a place, for tests.
  pixel(place: number[]): number[] { return this.stage.pixel(new Vector3().fromArray(place)); }

  close(): void {
    this.gizmo.dispose();
    this.stage.close();
    this.element.remove();
  }
}

// Where most points are.
function middleOf(points: Float32Array): Box3 {
  const n = points.length / 3;
  if (n === 0) return new Box3(new Vector3(-1, -1, 0), new Vector3(1, 1, 1));
  const [low, high] = [new Vector3(), new Vector3()];
  for (let axis = 0; axis < 3; axis++) {
    const places = Float32Array.from({ length: n }, (_, i) => points[3 * i + axis]).sort();
    low.setComponent(axis, places[Math.floor(FEW * (n - 1))]);
    high.setComponent(axis, places[Math.ceil((1 - FEW) * (n - 1))]);
  }
  return new Box3(low, high);
}
