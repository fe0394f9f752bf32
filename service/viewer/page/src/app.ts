// The page's state and what can be done to it; main.ts connects it to keys, pointer and URL.
import { Box3, Mesh, Vector3 } from "three";
import { Balance } from "./balance";
import { Cones, Contacts } from "./contacts";
import { Body, Movable, Result, readPayload, spanAt } from "./data";
import { el, tellTimes } from "./dom";
import { Ghosts } from "./ghosts";
import { Goal } from "./goal";
import { HandContacts } from "./hand-contacts";
import { Header, makeHeader, makeHelp, headline, tone } from "./header";
import { Labels } from "./labels";
import { Layer } from "./layer";
import { Loads } from "./loads";
import { Marks } from "./marks";
import { Motion } from "./motion";
import { Panel } from "./panel";
import { readPoseGraph } from "./pose-data";
import { PoseGraphView } from "./pose-graph";
import { Poses } from "./poses";
import { Forces, Regions } from "./regions";
import { Robot } from "./robot";
import { Shapeless } from "./shapeless";
import { SimulatedRobot } from "./simulated";
import { Stage, Subject, View } from "./stage";
import { Targets } from "./targets";
import { THEMES } from "./theme";
import { Player, SPEEDS, Timeline } from "./timeline";
import { Visuals } from "./visuals";
import { Cloud, Floor, Movables, Pieces, floorHeight } from "./world";

export class App implements Player {
  readonly result: Result = readPayload();
  readonly motion = new Motion(this.result);
  readonly stage: Stage;
  readonly layers: Layer[];
  readonly robot: Robot;
  readonly ghosts: Ghosts;
  readonly pieces: Pieces;
  readonly movables: Movables;
  readonly marks: Marks;
  readonly goal: Goal;
  readonly ground: number; // its height
  readonly labels: Labels;
  readonly poses?: Poses;
  readonly help: HTMLElement;
  readonly tip = el("div", "tip");
  private readonly scales = el("div", "scales");
  time: number;
  isPlaying = false;
  speed = 1;
  view: View | null = null;
  isXray = false;
  isFollowing = false;
  theme: "dark" | "light";
  readonly timeline: Timeline;
  private readonly panel: Panel;
  private readonly header: Header;
  private readonly hand: number;
  private last = 0;
  private hadGhosts = false;

  constructor() {
    const { result, motion } = this;
    tellTimes(result.is_timed);
    this.time = motion.start;
    this.hand = this.workingHand();
    const viewport = el("main", "viewport");
    const overlay = el("div", "labels");
    this.tip.hidden = true;
    viewport.append(overlay, this.scales, this.tip);
    this.labels = new Labels(overlay);
    this.header = makeHeader(result, (view) => this.show(view), {
      theme: () => this.setTheme(this.theme === "dark" ? "light" : "dark"), xray: () => this.setXray(!this.isXray),
      help: () => { this.help.hidden = !this.help.hidden; }, panel: () => this.togglePanel(),
    });
    document.body.append(this.header.element, viewport);

    const z = this.ground = floorHeight(result, motion);
    this.goal = new Goal(result, motion);
    const subject = this.subject(z);
    this.stage = new Stage(viewport, subject);
    const visuals = new Visuals(result.visuals, motion);
    this.robot = new Robot(result.bodies, motion, visuals.count > 0);
    this.ghosts = new Ghosts([...result.bodies, ...this.movedBodies()], motion, result.waypoints);
    this.pieces = new Pieces(result);
    this.movables = new Movables(result, motion);
    const targets = new Targets(result);
    const loads = new Loads(result, motion);
    this.marks = new Marks(result.checks, motion.start, (name, t) => this.placeOf(name, t), this.labels, () => this.solids());
    const centre = subject.box.getCenter(new Vector3());
    const reach = Math.max(6, subject.box.getSize(new Vector3()).length() * 2.2);
    this.layers = [
      ...(visuals.count > 0 ? [visuals] : []), this.robot, this.ghosts, this.pieces, this.movables, targets, new Balance(result, z), new Contacts(result),
      new Cones(result), new Regions(result, z), new Forces(result), loads, new HandContacts(result), this.goal,
      new Shapeless(result.shapeless, motion), this.marks,
      new Cloud(result.cloud), new Floor(result, z, centre, reach),
      ...(result.simulated ? [new SimulatedRobot(result, [...result.bodies, ...this.movedBodies()], result.simulated)] : []),
    ];
    const graph = result.pose_graph && readPoseGraph(result.pose_graph);
    if (graph) this.layers.splice(2, 0, (this.poses = new Poses(graph, result.bodies, () => this.sampledPhase())));
    if (result.simulated) this.ghosts.group.visible = false;
    for (const label of [...targets.labels, ...this.movables.labels, ...loads.labels, ...this.goal.labels]) this.labels.add(label);
    for (const layer of this.layers) this.stage.scene.add(layer.group);
    this.panel = new Panel(result, this.layers, (index) => this.chooseCheck(index), (layer) => this.toggle(layer));
    if (graph) this.showGraph(new PoseGraphView(graph, { show: (phase, pose) => this.showPoses(phase, pose) }));
    this.timeline = new Timeline(result, this, this.ghosts.times);
    this.help = makeHelp(this.layers);
    document.body.append(this.panel.element, this.timeline.element, this.help);
    document.body.classList.toggle("still", motion.nFrames < 2);
    document.body.classList.add(tone(headline(result)));
    this.stage.onFrame = () => this.labels.place(this.stage.camera, ...this.stage.size);
    this.stage.onMoved = () => this.header.setView((this.view = null));
    const wantsLight = matchMedia("(prefers-color-scheme: light)");
    this.theme = wantsLight.matches ? "light" : "dark";
    wantsLight.addEventListener("change", () => this.setTheme(wantsLight.matches ? "light" : "dark"));
    this.setTheme(this.theme);
    this.stage.resize();
    this.show("3d", true);
    this.seek(motion.start);
  }

  get start(): number { return this.motion.start; }
  // Of the plan; a robot that fell in physics is seen to the end of its fall.
  get end(): number {
    const { simulated } = this.result;
    return Math.max(this.motion.end, simulated?.verdict === "FELL" ? simulated.times.at(-1) ?? 0 : 0);
  }

  solids(): { name: string; mesh: Mesh }[] {
    return [
      ...this.robot.meshes.map((mesh) => ({ name: mesh.name, mesh })), ...this.pieces.solids, ...this.movables.solids,
      ...this.goal.solids,
    ];
  }

  // Where something a check names is: a link or joint, a body of it, something that is moved, a piece of the world.
  private placeOf(name: string, t: number): Vector3 | undefined {
    const link = this.motion.place(name, t) ?? this.motion.place(name.split("/")[0], t);
    if (link) return link;
    const isNamed = (movable: Movable): boolean => [movable.joint, movable.name, ...movable.bodies.map((body) => body.name)].includes(name);
    const movable = this.result.movables.find(isNamed);
    if (movable) return this.motion.place(movable.name, t) ?? new Vector3().fromArray(movable.origin);
    const sphere = this.pieces.solids.find((piece) => piece.name === name)?.mesh.geometry.boundingSphere;
    return sphere?.center.clone();
  }

  // The bodies of what the task moves, by link, as those of the robot.
  private movedBodies(): Body[] {
    return this.result.movables.flatMap(({ name: link, bodies }) => bodies.map(({ name, hull }) => ({ name, link, hull })));
  }

  // The link a target speaks of, else the hand that travels most, else the link that does.
  private workingHand(): number {
    const { links, nFrames } = this.motion;
    if (nFrames === 0) return -1;
    const asked = this.result.phases.flatMap((phase) => phase.targets ?? []).map((target) => links.indexOf(target.frame ?? ""));
    const found = asked.find((link) => link >= 0);
    if (found !== undefined) return found;
    const own = links.map((_, link) => link).filter((link) => !this.result.movables.some(({ name }) => name === links[link]));
    const hands = own.filter((link) => /hand|tool|gripper/i.test(links[link]));
    const pool = hands.length > 0 ? hands : own;
    return pool.reduce((best, link) => (this.motion.travel(link) > this.motion.travel(best) ? link : best), pool[0] ?? -1);
  }

  private subject(z: number): Subject {
    const { result, motion, hand } = this;
    const box = new Box3();
    const p = new Vector3();
    for (let i = 0; i <= 12 && motion.nFrames > 0; i++) {
      const matrices = motion.links.map((_, link) => motion.matrix(link, motion.start + (i / 12) * (motion.end - motion.start)));
      for (const body of [...result.bodies, ...this.movedBodies()]) {
        const matrix = matrices[motion.links.indexOf(body.link)];
        const { vertices } = body.hull;
        for (let k = 0; k < vertices.length; k += 3) box.expandByPoint(p.fromArray(vertices, k).applyMatrix4(matrix));
      }
    }
    if (box.isEmpty()) {
      for (const { origin, bodies } of [...result.movables, { origin: [0, 0, 0], bodies: result.pieces }]) {
        for (const { hull } of bodies) {
          for (let i = 0; i < hull.vertices.length; i += 3) box.expandByPoint(p.fromArray(hull.vertices, i).add(new Vector3().fromArray(origin)));
        }
      }
    }
    box.union(this.goal.box);
    if (box.isEmpty()) box.set(new Vector3(-1, -1, 0), new Vector3(1, 1, 1));
    box.min.z = Math.min(box.min.z, z);
    const heading = new Vector3(1, 0, 0);
    const root = motion.links.findIndex((name) => /pelvis|torso|trunk|base/i.test(name));
    if (motion.nFrames > 0 && root >= 0) heading.transformDirection(motion.matrix(root, motion.start));
    heading.z = 0;
    if (heading.length() < 0.1) heading.set(1, 0, 0);
    heading.normalize();
    const side = hand >= 0 && /^r_|right|_r$/i.test(motion.links[hand]) ? -1 : 1;
    return { box, heading, side, hand: () => (hand < 0 ? undefined : motion.place(motion.links[hand], this.time)) };
  }

  seek(t: number): void {
    const before = this.hand >= 0 ? this.motion.place(this.motion.links[this.hand], this.time) : undefined;
    this.time = Math.min(Math.max(t, this.start), this.end);
    for (const layer of this.layers) layer.update?.(this.time);
    if (this.isFollowing && before) {
      this.stage.follow(this.motion.place(this.motion.links[this.hand], this.time)!.sub(before));
    }
    this.timeline.update();
    this.explain();
    this.panel.setPhase(spanAt(this.result.phases, this.time));
    this.stage.draw();
  }

  toggle(layer: Layer): void;
  toggle(): void;
  toggle(layer?: Layer): void {
    if (!layer) return this.play(!this.isPlaying);
    this.setLayer(layer, !layer.group.visible);
  }

  setLayer(layer: Layer, isVisible: boolean): void {
    layer.group.visible = isVisible;
    layer.update?.(this.time);
    if (layer === this.poses) {
      this.poses.onChange();
      this.fadeRobot();
    }
    this.panel.setLayer(layer);
    this.marks.refresh();
    this.explain();
    this.stage.draw();
  }

  // What the colours of forces and regions mean, of the layers that show some now.
  private explain(): void {
    const rows = this.layers.flatMap((layer) => layer.legend?.() ?? []);
    this.scales.hidden = rows.length === 0;
    this.scales.replaceChildren(...rows.map(({ colour, text }) => {
      const swatch = el("i");
      swatch.style.background = colour;
      return el("div", "", swatch, text);
    }));
  }

  play(on: boolean): void {
    if (on && this.end <= this.start) return;
    if (on && this.time >= this.end - 1e-6) this.seek(this.start);
    this.isPlaying = on;
    this.last = performance.now();
    this.timeline.update();
    if (on) requestAnimationFrame(() => this.tick());
  }

  private tick(): void {
    if (!this.isPlaying) return;
    const now = performance.now();
    // A page that was in the background goes on where it was.
    const passed = Math.min((now - this.last) / 1000, 0.25);
    this.last = now;
    this.seek(this.time + passed * this.speed);
    if (this.time >= this.end) this.play(false);
    else requestAnimationFrame(() => this.tick());
  }

  setSpeed(speed: number): void {
    this.speed = speed;
    this.timeline.update();
  }

  shiftSpeed(direction: number): void {
    this.setSpeed(SPEEDS[Math.min(Math.max(SPEEDS.indexOf(this.speed) + direction, 0), SPEEDS.length - 1)]);
  }

  step(direction: number): void { this.stepTo(this.ghosts.times.length > 0 ? this.ghosts.times : [this.start, this.end], direction); }
  stepFrame(direction: number): void { this.stepTo(Array.from(this.result.times), direction); }
  stepPhase(direction: number): void { this.stepTo([...this.result.phases.map((phase) => phase.start), this.end], direction); }

  private stepTo(times: number[], direction: number): void {
    this.play(false);
    const sorted = [...times].sort((a, b) => a - b);
    const next = direction > 0 ? sorted.find((t) => t > this.time + 1e-4) : sorted.reverse().find((t) => t < this.time - 1e-4);
    if (next !== undefined) this.seek(next);
  }

  focusGhost(index: number): void {
    this.ghosts.setFocus(index);
    this.stage.draw();
  }

  // A solid pose and the robot where it is now would hide each other: the robot becomes glass.
  private fadeRobot(): void { this.robot.xray(this.isXray || this.poses?.group.visible === true); }

  private showGraph(view: PoseGraphView): void {
    this.panel.insert(view.element);
    const poses = this.poses!;
    poses.onChange = () => view.mark(poses.group.visible ? poses.phase : -1, poses.selected, poses.group.visible ? poses.strong : -1);
    poses.onChange();
  }

  // The sampled phase that the motion is in or was in last.
  private sampledPhase(): number {
    const names = this.result.pose_graph!.phases.map((phase) => phase.name);
    const begun = this.result.phases.filter((phase) => phase.start <= this.time + 1e-6);
    return Math.max(0, ...begun.map((phase) => names.indexOf(phase.name.split(": ")[0])));
  }

  // Show the poses of a phase and one of them strongly; -1: the chosen one, or no phase. Ghosts of waypoints would hide them.
  showPoses(phase: number, pose = -1): void {
    if (!this.poses) return;
    const isNew = phase >= 0 && !this.poses.group.visible;
    if (isNew) this.hadGhosts = this.ghosts.group.visible;
    this.poses.show(phase, pose);
    if (isNew) this.setLayer(this.ghosts, false);
    if (phase < 0 && this.poses.group.visible && this.hadGhosts) this.setLayer(this.ghosts, true);
    this.setLayer(this.poses, phase >= 0);
  }

  // Go to the time and place a check speaks of, and mark it there; -1 deselects.
  chooseCheck(index: number): void {
    this.marks.select(index);
    this.panel.select(index);
    const where = this.result.checks[index]?.where;
    if (where && typeof where.time_s === "number") {
      this.play(false);
      this.seek(where.time_s);
    }
    const place = index >= 0 ? this.marks.places[index] : undefined;
    if (place) {
      this.header.setView((this.view = null));
      // The bodies a check speaks of may stand where they are; the rest of the robot should not hide the place.
      const names = new Set(where?.names ?? []);
      this.stage.focus(place, this.robot.meshes.filter((mesh) => !names.has(mesh.name.split("/")[0])));
    }
    this.stage.draw();
  }

  nextCheck(): void {
    const n = this.result.checks.length;
    if (n > 0) this.chooseCheck((this.marks.chosen + 1) % n);
  }

  show(view: View, isSudden = false): void {
    this.view = view;
    this.header.setView(view);
    this.setXray(view === "top");
    this.stage.show(view, isSudden);
  }

  setXray(on: boolean): void {
    this.isXray = on;
    for (const layer of this.layers) layer.xray?.(on);
    if (this.poses) this.fadeRobot();
    this.header.setXray(on);
    this.stage.draw();
  }

  setTheme(theme: "dark" | "light"): void {
    this.theme = theme;
    document.documentElement.dataset.theme = theme;
    for (const layer of this.layers) layer.recolour(THEMES[theme]);
    this.stage.recolour(THEMES[theme]);
    this.explain();
  }

  togglePanel(): void { document.body.classList.toggle("wide"); }

  savePicture(): void {
    this.stage.render();
    this.stage.renderer.domElement.toBlob((blob) => {
      if (!blob) return;
      const link = el("a");
      link.href = URL.createObjectURL(blob);
      link.download = `${this.result.robot || "scene"}-${this.time.toFixed(2)}s.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    });
  }
}
