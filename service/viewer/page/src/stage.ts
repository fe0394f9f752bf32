// Renderer, light and camera; draws only when something changed.
import {
  Box3, DirectionalLight, HemisphereLight, Mesh, MOUSE, Object3D, PCFShadowMap, PerspectiveCamera, Raycaster, Scene, SRGBColorSpace,
  Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { Colours } from "./theme";

export type View = "3d" | "front" | "side" | "top" | "hand";
export const VIEWS: View[] = ["3d", "front", "side", "top", "hand"];

export interface Subject {
  box: Box3;            // the robot over its whole motion and what it moves
  heading: Vector3;     // where the robot faces at the start, level
  side: number;         // +1 when the working hand is the left one, -1 for the right
  hand(): Vector3 | undefined;
}

export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(32, 1, 0.05, 200);
  readonly renderer: WebGLRenderer;
  readonly controls: OrbitControls;
  frames = 0;
  onFrame: () => void = () => {};
  onMoved: () => void = () => {};
  private readonly sun = new DirectionalLight("#ffffff", 2.1);
  private readonly sky = new HemisphereLight("#ffffff", "#888888", 1.5);
  private readonly watcher: ResizeObserver;
  private isWaiting = false;
  private glide: { from: [Vector3, Vector3]; to: [Vector3, Vector3]; began: number } | null = null;

  constructor(private readonly host: HTMLElement, private readonly subject: Subject) {
    Object3D.DEFAULT_UP.set(0, 0, 1);
    this.camera.up.set(0, 0, 1);
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true, stencil: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.outputColorSpace = SRGBColorSpace;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    host.prepend(this.renderer.domElement);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.mouseButtons = { LEFT: MOUSE.ROTATE, MIDDLE: MOUSE.PAN, RIGHT: MOUSE.PAN };
    this.controls.minDistance = 0.15;
    this.controls.maxDistance = 40;
    this.controls.addEventListener("change", () => this.draw());
    this.controls.addEventListener("start", () => {
      this.glide = null;
      this.onMoved();
    });
    this.light();
    this.watcher = new ResizeObserver(() => this.resize());
    this.watcher.observe(host);
    this.resize();
  }

  private light(): void {
    const centre = this.subject.box.getCenter(new Vector3());
    const radius = Math.max(1.2, this.subject.box.getSize(new Vector3()).length() / 2);
    const { heading, side } = this.subject;
    const left = new Vector3(-heading.y, heading.x, 0);
    this.sun.position.copy(centre).addScaledVector(heading, -2).addScaledVector(left, 2.5 * side).add(new Vector3(0, 0, 5));
    this.sun.target.position.copy(centre);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    this.sun.shadow.radius = 4;
    this.sun.shadow.normalBias = 0.012;
    Object.assign(this.sun.shadow.camera, { left: -radius, right: radius, top: radius, bottom: -radius, near: 0.5, far: 14 });
    const fill = new DirectionalLight("#bcd3ff", 0.7);
    fill.position.copy(centre).addScaledVector(heading, 3).addScaledVector(left, -3 * side).add(new Vector3(0, 0, 1.5));
    fill.target.position.copy(centre);
    this.scene.add(this.sky, this.sun, this.sun.target, fill, fill.target);
  }

  recolour(colours: Colours): void {
    this.sky.color.set(colours.sky);
    this.sky.groundColor.set(colours.ground);
    this.draw();
  }

  // Give the canvas and what the graphics card keeps of it back; the stage draws nothing afterwards.
  close(): void {
    this.watcher.disconnect();
    this.isWaiting = true;
    this.glide = null;
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
    this.renderer.domElement.remove();
  }

  // Whether a drawing or a camera move is still to come.
  get isBusy(): boolean { return this.isWaiting || this.glide !== null; }

  get size(): [number, number] { return [this.host.clientWidth, this.host.clientHeight]; }

  resize(): void {
    const [width, height] = this.size;
    if (width === 0 || height === 0) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.renderer.setSize(width, height);
    this.render();
  }

  draw(): void {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame(() => {
      if (!this.renderer.domElement.isConnected) return;
      this.isWaiting = false;
      this.step();
      this.render();
    });
  }

  render(): void {
    this.renderer.render(this.scene, this.camera);
    this.frames += 1;
    this.onFrame();
  }

  private step(): void {
    if (!this.glide) return;
    const u = Math.min((performance.now() - this.glide.began) / 450, 1);
    const eased = u * u * (3 - 2 * u);
    const { from, to } = this.glide;
    this.camera.position.lerpVectors(from[0], to[0], eased);
    this.controls.target.lerpVectors(from[1], to[1], eased);
    if (u >= 1) this.glide = null;
    this.controls.update();
    this.draw();
  }

  moveTo(position: Vector3, target: Vector3, isSudden = false): void {
    if (isSudden || matchMedia("(prefers-reduced-motion: reduce)").matches) {
      this.glide = null;
      this.camera.position.copy(position);
      this.controls.target.copy(target);
      this.controls.update();
    } else {
      this.glide = {
        from: [this.camera.position.clone(), this.controls.target.clone()], to: [position, target], began: performance.now(),
      };
    }
    this.draw();
  }

  show(view: View, isSudden = false): void {
    const { box, heading, side } = this.subject;
    const left = new Vector3(-heading.y, heading.x, 0);
    const up = new Vector3(0, 0, 1);
    const centre = box.getCenter(new Vector3());
    const hand = this.subject.hand();
    const direction = {
      "3d": heading.clone().multiplyScalar(-0.62).addScaledVector(left, side).addScaledVector(up, 0.5),
      front: heading.clone().addScaledVector(up, 0.06),
      side: left.clone().multiplyScalar(side).addScaledVector(up, 0.04),
      // A hair off the vertical, so that the robot faces up on the screen.
      top: up.clone().addScaledVector(heading, -1e-3),
      hand: heading.clone().multiplyScalar(-0.5).addScaledVector(left, side).addScaledVector(up, 0.45),
    }[view].normalize();
    if (view === "hand" && hand) return this.moveTo(hand.clone().addScaledVector(direction, 1.6), hand, isSudden);
    this.moveTo(centre.clone().addScaledVector(direction, this.fitting(direction, box)), centre, isSudden);
  }

  // Distance from the box's centre at which all of it is in view along a direction [m].
  fitting(direction: Vector3, box: Box3): number {
    const z = direction;
    const x = new Vector3(0, 0, 1).cross(z).normalize();
    const y = z.clone().cross(x);
    const half = box.getSize(new Vector3()).multiplyScalar(0.5);
    const tall = Math.tan((this.camera.fov * Math.PI) / 360);
    let distance = 0.5;
    for (let corner = 0; corner < 8; corner++) {
      const p = new Vector3(corner & 1 ? half.x : -half.x, corner & 2 ? half.y : -half.y, corner & 4 ? half.z : -half.z);
      const needed = Math.max(Math.abs(p.dot(y)) / tall, Math.abs(p.dot(x)) / (tall * this.camera.aspect));
      distance = Math.max(distance, needed + p.dot(z));
    }
    return 1.03 * distance;
  }

  // Look at a place from near and, as far as possible, from the side the camera is on: the view is turned about the
  // vertical until none of the blockers stands in between.
  focus(place: Vector3, blockers: Mesh[] = []): void {
    const away = this.camera.position.clone().sub(this.controls.target);
    const distance = Math.min(2.4, Math.max(away.length(), 0.8));
    away.normalize();
    away.z = Math.min(Math.max(away.z, 0.15), 0.75);
    const directions = [0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180].map((degrees) =>
      away.clone().applyAxisAngle(new Vector3(0, 0, 1), (degrees * Math.PI) / 180).normalize());
    this.scene.updateMatrixWorld();
    const isClear = (direction: Vector3): boolean => {
      const eye = place.clone().addScaledVector(direction, distance);
      return new Raycaster(eye, direction.clone().negate(), 0, distance - 0.02).intersectObjects(blockers, false).length === 0;
    };
    const direction = directions.find(isClear) ?? directions[0];
    this.moveTo(place.clone().addScaledVector(direction, distance), place);
  }

  // Keep the view but carry its centre along.
  follow(shift: Vector3): void {
    this.camera.position.add(shift);
    this.controls.target.add(shift);
  }

  pixel(place: Vector3): [number, number] {
    const [width, height] = this.size;
    this.camera.updateMatrixWorld();
    const p = place.clone().project(this.camera);
    const rect = this.renderer.domElement.getBoundingClientRect();
    return [rect.left + ((p.x + 1) * width) / 2, rect.top + ((1 - p.y) * height) / 2];
  }

  ray(x: number, y: number): Raycaster {
    const rect = this.renderer.domElement.getBoundingClientRect();
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2((2 * (x - rect.left)) / rect.width - 1, 1 - (2 * (y - rect.top)) / rect.height), this.camera);
    return caster;
  }
}
