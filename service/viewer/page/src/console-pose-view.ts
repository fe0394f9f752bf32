// The ghost in its surroundings: its handles, the drag of one or several of them, and the robot as it is measured.
import { BufferGeometry, Float32BufferAttribute, GridHelper, Line, LineBasicMaterial, Matrix4, Mesh, MeshBasicMaterial, Object3D, Quaternion, SphereGeometry, Vector3 } from "three";
import { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
import { tintByHeight } from "./console-data";
import { JointedRobot } from "./console-jointed";
import { Measured, OpenedPose, Pose, Target, inOrder } from "./console-pose-data";
import { el } from "./dom";
import { Quantized, points as unpack } from "./packed";
import { pointCloud } from "./scene-layers";
import { Stage } from "./stage";
import { THEMES } from "./theme";

const GHOST = "#4cc3ff";
const PREVIEW = "#9fb3c4";
const MEASURED = "#ff9a3c";
const HANDLE = "#4ade80";
const FOOT = "#8b97a8";
const STILL = 4;  // [px] that a click may move

export class PoseView {
  readonly element = el("div", "scanview");
  readonly stage: Stage;
  onDrag: (targets: Target[]) => void = () => {};
  onRelease: () => void = () => {};
  onChoose: (links: string[]) => void = () => {};
  readonly ghost: JointedRobot;
  chosen: string[] = [];
  private readonly measured: JointedRobot;
  private readonly gizmo: TransformControls;
  private readonly proxy = new Object3D();
  private readonly handles = new Map<string, Mesh>();
  private readonly miss = new Line(new BufferGeometry(), new LineBasicMaterial({ color: "#ff5c5c" }));
  private grabbed = new Map<string, Matrix4>();  // where the handles were when the drag began
  private begin = new Matrix4();                 // where the proxy was
  private isDragging = false;

  constructor(private readonly opened: OpenedPose, cloud: Quantized | null, host: HTMLElement) {
    host.append(this.element);
    this.ghost = new JointedRobot(opened.drawing, GHOST, 1);
    this.measured = new JointedRobot(opened.drawing, MEASURED, 0.55);
    this.measured.group.visible = false;
    this.ghost.set(opened.pose.base, opened.pose.positions);
    const theme = document.documentElement.dataset.theme === "light" ? "light" : "dark";
    this.stage = new Stage(this.element, { box: this.ghost.box().expandByScalar(0.25), heading: new Vector3(1, 0, 0), side: 1, hand: () => undefined });
    this.stage.scene.add(this.ghost.group, this.measured.group, this.proxy, this.miss);
    if (cloud) {
      const places = unpack(cloud);
      this.stage.scene.add(pointCloud(places, tintByHeight(places), 9, 1));
    }
    for (const link of opened.links) this.addHandle(link);
    this.gizmo = new TransformControls(this.stage.camera, this.stage.renderer.domElement);
    this.gizmo.setSize(0.7);
    this.stage.scene.add(this.gizmo.getHelper());
    this.gizmo.addEventListener("change", () => this.stage.draw());
    this.gizmo.addEventListener("dragging-changed", ({ value }) => this.grab(value === true));
    this.gizmo.addEventListener("objectChange", () => this.lead());
    this.stage.recolour(THEMES[theme]);
    this.listen();
    this.place();
    this.stage.resize();
    this.look();
  }

  // From before the robot, a little aside and above.
  private look(): void {
    const box = this.ghost.box();
    const grid = new GridHelper(4, 16, THEMES.dark.grid, THEMES.dark.grid);
    grid.rotateX(Math.PI / 2);
    grid.position.z = box.min.z;
    Object.assign(grid.material, { transparent: true, opacity: 0.35 });
    this.stage.scene.add(grid);
    const direction = new Vector3(1, -0.7, 0.35).normalize();
    this.stage.moveTo(box.getCenter(new Vector3()).addScaledVector(direction, 1.15 * this.stage.fitting(direction, box)), box.getCenter(new Vector3()), true);
  }

  private addHandle(link: string): void {
    const stands = this.opened.feet.includes(link);
    const handle = new Mesh(new SphereGeometry(0.035, 20, 14), new MeshBasicMaterial({ color: stands ? FOOT : HANDLE, depthTest: false, transparent: true, opacity: 0.85 }));
    handle.renderOrder = 3;
    handle.userData.link = link;
    this.handles.set(link, handle);
    this.stage.scene.add(handle);
  }

  private listen(): void {
    const canvas = this.stage.renderer.domElement;
    let pressed = [0, 0];
    canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; });
    canvas.addEventListener("click", (event) => {
      if (Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) >= STILL) return;
      const hits = this.stage.ray(event.clientX, event.clientY).intersectObjects([...this.handles.values()], false);
      if (hits.length === 0) return;
      const link = hits[0].object.userData.link as string;
      this.choose(event.shiftKey ? [...this.chosen.filter((one) => one !== link), link] : [link]);
    });
  }

  // Lead these links; the gizmo is at the last of them, and moves the others along.
  choose(links: string[]): void {
    this.chosen = links;
    for (const [link, handle] of this.handles) handle.scale.setScalar(links.includes(link) ? 1.5 : 1);
    if (links.length > 0) this.gizmo.attach(this.proxy);
    else this.gizmo.detach();
    this.place();
    this.onChoose(links);
  }

  turn(on: boolean): void { this.gizmo.setMode(on ? "rotate" : "translate"); }

  private grab(on: boolean): void {
    this.isDragging = on;
    this.stage.controls.enabled = !on;
    if (on) {
      this.begin.copy(this.matrixOfProxy());
      this.grabbed = new Map(this.chosen.map((link) => [link, this.ghost.frame(link)!]));
    } else this.onRelease();
  }

  private matrixOfProxy(): Matrix4 {
    this.proxy.updateMatrix();
    return this.proxy.matrix.clone();
  }

  // Where the gizmo has the links, by the same motion of all.
  private lead(): void {
    if (!this.isDragging) return;
    this.onDrag(this.targets(this.matrixOfProxy().multiply(this.begin.clone().invert())));
    this.drawMiss();
  }

  private targets(motion: Matrix4): Target[] {
    return [...this.grabbed].map(([link, from]) => {
      const [position, turned] = [new Vector3(), new Quaternion()];
      motion.clone().multiply(from).decompose(position, turned, new Vector3());
      return { link, position: position.toArray(), quaternion_wxyz: [turned.w, turned.x, turned.y, turned.z] };
    });
  }

  show(pose: Pose): void {
    this.ghost.set(pose.base, pose.positions);
    this.ghost.tint(pose.is_checked ? GHOST : PREVIEW);
    this.place();
  }

  // The robot as it is measured; hidden where its joints are not those of the ghost.
  showMeasured(names: string[], { base, positions }: Measured): void {
    const own = inOrder(names, positions, this.opened.joint_names);
    this.measured.group.visible = own !== null && (base.length > 0 || this.opened.pose.base.length === 0);
    if (own && this.measured.group.visible) this.measured.set(base, own);
    this.stage.draw();
  }

  get isMeasuredShown(): boolean { return this.measured.group.visible; }

  // Put the handles, and the gizmo unless it is dragged, where the ghost has its links.
  place(): void {
    for (const [link, handle] of this.handles) {
      const at = this.ghost.frame(link);
      if (at) handle.position.setFromMatrixPosition(at);
    }
    const at = this.ghost.frame(this.chosen.at(-1) ?? "");
    if (at && !this.isDragging) at.decompose(this.proxy.position, this.proxy.quaternion, new Vector3());
    this.drawMiss();
    this.stage.draw();
  }

  private drawMiss(): void {
    const at = this.ghost.frame(this.chosen.at(-1) ?? "");
    this.miss.visible = at !== undefined && this.isDragging;
    if (!at) return;
    const ends = [...new Vector3().setFromMatrixPosition(at).toArray(), ...this.proxy.position.toArray()];
    this.miss.geometry.setAttribute("position", new Float32BufferAttribute(ends, 3));
  }

  // Page pixel of a handle, for tests.
  pixelOf(link: string): number[] | null {
    const handle = this.handles.get(link);
    return handle ? this.stage.pixel(handle.position) : null;
  }

  placeOf(link: string): number[] | null {
    const at = this.ghost.frame(link);
    return at ? new Vector3().setFromMatrixPosition(at).toArray() : null;
  }

  close(): void {
    this.gizmo.dispose();
    this.stage.close();
    this.element.remove();
  }
}
